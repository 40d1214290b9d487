"""Run the tasks that are not up to date, each after what it reads, as many at a time as fit.

Of the tasks that could start, the one with the most stages still behind it does: at the end, when
fewer tasks than workers are left, these are short chains and not a whole cell.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait

from study.common.files import write_text
from study.workflow.store import Store, Task
from study.workflow.worker import Outcome, execute


def run_tasks(
    tasks: Iterable[Task],
    store: Store,
    executor: Executor,
    workers: int,
    threads: int,
    started: Callable[[Task], None],
    ended: Callable[[Outcome], None],
) -> dict[Task, str]:
    """Run `tasks`, given in an order in which each stands after what it reads.

    A task whose input failed is not run; the others are.

    Returns:
        the error, in one line, of every task that failed or could not be run.
    """
    waiting = longest_first(list(tasks))
    errors: dict[Task, str] = {}
    running: dict[Future[Outcome], Task] = {}
    unfinished = set(waiting)
    while waiting or running:
        for task in list(waiting):
            broken = [source for source in task.inputs.values() if source in errors]
            if broken:
                waiting.remove(task)
                unfinished.discard(task)
                errors[task] = f"not run: {broken[0].name} failed"
                ended(Outcome(task, 0.0, errors[task]))
            elif len(running) < workers and not unfinished.intersection(task.inputs.values()):
                waiting.remove(task)
                started(task)
                running[executor.submit(execute, task, store.root, threads)] = task
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            task = running.pop(future)
            outcome = _outcome(task, future)
            unfinished.discard(task)
            if outcome.error is not None:
                errors[task] = outcome.error
                write_text(store.failure(task), outcome.error + "\n")
            ended(outcome)
    return errors


def longest_first(tasks: list[Task]) -> list[Task]:
    """`tasks` by how many more are on the longest way from each to the end; ties as they were.

    Still each after what it reads, as they have to be given.
    """
    behind = dict.fromkeys(tasks, 0)
    for task in reversed(tasks):
        for source in task.inputs.values():
            behind[source] = max(behind.get(source, 0), behind[task] + 1)
    return sorted(tasks, key=behind.__getitem__, reverse=True)


def _outcome(task: Task, future: Future[Outcome]) -> Outcome:
    """The task's own outcome, or what became of the process that ran it."""
    try:
        return future.result()
    except Exception as error:
        message = " ".join(str(error).split())[:300]
        return Outcome(task, 0.0, f"the worker was lost ({type(error).__name__}: {message})")
