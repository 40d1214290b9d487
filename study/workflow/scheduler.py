"""Run tasks in parallel, every task after its inputs.

Of the ready tasks, the one with the longest chain of dependent tasks starts first (list scheduling
by critical path). So only short chains remain near the end, and all workers stay busy.
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
    """Run all tasks but those whose inputs failed.

    Args:
        tasks: in an order in which every task comes after its inputs.
        store: holds the folders of the tasks.
        executor: see `study.workflow.engine`.
        workers: number of tasks that run at a time.
        threads: CPU threads of a task.
        started: called with a task when the task starts.
        ended: called with the outcome of a task when the task ends.

    Returns:
        the error, in one line, of every task that failed or was not run.
    """
    waiting = longest_first(list(tasks))
    errors: dict[Task, str] = {}
    running: dict[Future[Outcome], Task] = {}
    unfinished = set(waiting)
    while waiting or running:
        for task in list(waiting):
            failed = [source for source in task.inputs.values() if source in errors]
            if failed:
                waiting.remove(task)
                unfinished.discard(task)
                errors[task] = f"{NOT_RUN}: {failed[0].name} failed"
                ended(Outcome(task, 0.0, errors[task]))
            elif len(running) < workers and not unfinished.intersection(task.inputs.values()):
                waiting.remove(task)
                started(task)
                running[executor.submit(execute, task, store.root, threads)] = task
        completed, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in completed:
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
    """The task's outcome, which is a failure if the worker process died."""
    try:
        return future.result()
    except Exception as error:
        message = " ".join(str(error).split())[:300]
        return Outcome(task, 0.0, f"the worker was lost ({type(error).__name__}: {message})")
