"""Run tasks, each after its inputs, as many at a time as there are workers.

Of the tasks that are ready, the one with the longest chain of tasks behind it starts first (list
scheduling by critical path). Near the end, short chains are left, and the workers stay busy.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait

from study.common.files import write_text
from study.workflow.store import Store
from study.workflow.task import Task
from study.workflow.worker import Outcome, execute

NOT_RUN = "not run"
"""Begins the error of a task that was not run."""


def run_tasks(
    tasks: Iterable[Task],
    store: Store,
    executor: Executor,
    workers: int,
    threads: int,
    started: Callable[[Task], None],
    ended: Callable[[Outcome], None],
) -> dict[Task, str]:
    """Run tasks. A task whose input failed is not run; the others are.

    Args:
        tasks: in an order in which every task comes after its inputs.
        store: their folders.
        executor: runs them.
        workers: how many run at a time.
        threads: CPU threads of each.
        started: called with a task when it starts.
        ended: called with its outcome when it ends.

    Returns:
        the error, in one line, of every task that failed or was not run.
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
                errors[task] = f"{NOT_RUN}: {broken[0].name} failed"
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
    """Tasks by the length of the longest chain of tasks that follows each, longest first.

    Args:
        tasks: in an order in which every task comes after its inputs. The result is in such an
            order, too; ties keep their order.
    """
    length = dict.fromkeys(tasks, 0)
    for task in reversed(tasks):
        for source in task.inputs.values():
            length[source] = max(length.get(source, 0), length[task] + 1)
    return sorted(tasks, key=length.__getitem__, reverse=True)


def _outcome(task: Task, future: Future[Outcome]) -> Outcome:
    """The task's outcome; if its process died, a failure that says so."""
    try:
        return future.result()
    except Exception as error:
        message = " ".join(str(error).split())[:300]
        return Outcome(task, 0.0, f"the worker was lost ({type(error).__name__}: {message})")
