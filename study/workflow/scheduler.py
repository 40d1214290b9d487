"""Run tasks in parallel, every task after its inputs.

A task whose worker was lost is tried again, `engine.retries` times. A task that fails by an error
of its own is not, since it would fail again.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, wait

from study.common.files import write_text
from study.workflow.lease import USUAL, Terms
from study.workflow.store import Store
from study.workflow.task import Task
from study.workflow.task_queue import TaskQueue
from study.workflow.worker import Outcome, execute
from study.workflow.workers import Workers

NOT_RUN = "not run"
"""Begins the error of a task that was not run."""
POLL = 5.0
"""Seconds between two polls of how many workers there are, at most."""


def run_tasks(
    tasks: Iterable[Task],
    store: Store,
    workers: Workers,
    threads: int,
    started: Callable[[Task], None],
    ended: Callable[[Outcome], None],
    terms: Terms = USUAL,
    lost: Callable[[Task, str], None] = lambda task, why: None,
) -> dict[Task, str]:
    """Run all tasks but those whose inputs failed.

    Args:
        tasks: in an order in which every task comes after its inputs.
        store: holds the folders of the tasks.
        workers: see `study.workflow.engine`.
        threads: CPU threads of a task.
        started: called with a task when the task starts.
        ended: called with the outcome of a task when the task ends.
        terms: of the leases of tasks, with the number of retries.
        lost: called with a task that is tried again, and why its worker was lost.

    Returns:
        the error, in one line, of every task that failed or was not run.

    Raises:
        StudyError: the workers cannot be reached any more.
    """
    queue = TaskQueue(tasks, workers.resource)
    errors: dict[Task, str] = {}
    attempts: Counter[Task] = Counter()
    running: dict[Future[Outcome], Task] = {}

    def end(outcome: Outcome) -> None:
        task = outcome.task
        if outcome.error is None:
            queue.finish(task)
        else:
            errors[task] = outcome.error
        ended(outcome)
        if outcome.error is not None:
            for dependent in queue.drop_dependents(task):
                end(Outcome(dependent, 0.0, f"{NOT_RUN}: {task.name} failed"))

    while queue or running:
        for task in queue.pop(workers.capacity(), running.values()):
            started(task)
            running[workers.submit(execute, task, store.root, threads, terms)] = task
        if not running:  # no worker has what the tasks need, and `wait` of nothing does not wait
            time.sleep(POLL)
            continue
        completed, _ = wait(running, timeout=POLL, return_when=FIRST_COMPLETED)
        for future in completed:
            task = running.pop(future)
            attempts[task] += 1
            outcome = _outcome(future)
            if isinstance(outcome, str):
                if attempts[task] <= terms.retries:
                    lost(task, outcome)
                    queue.push(task)
                    continue
                times = f" {attempts[task]} times" if attempts[task] > 1 else ""
                outcome = Outcome(task, 0.0, f"the worker was lost{times} ({outcome})")
            if outcome.error is not None:
                write_text(store.failure(task), outcome.error + "\n")
            end(outcome)
    return errors


def _outcome(future: Future[Outcome]) -> Outcome | str:
    """The outcome of a task, or in one line why its worker was lost."""
    try:
        return future.result()
    except Exception as error:
        return f"{type(error).__name__}: {' '.join(str(error).split())}"[:300]
