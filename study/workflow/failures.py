"""Which failed stage is the reason that a task is not complete."""

from study.workflow.store import Store
from study.workflow.task import Task


def failed_stage(
    task: Task, store: Store, known: dict[Task, Task | None] | None = None
) -> Task | None:
    """The first failed stage that a task needs, or the task itself; None if none failed.

    Args:
        task: the task.
        store: holds the folders of the tasks.
        known: the answers for some tasks, since several tasks may have one input.
    """
    known = {} if known is None else known
    if task not in known:
        known[task] = None
        if store.reason_to_run(task) is not None:
            causes = (failed_stage(source, store, known) for source in task.inputs.values())
            first = next((cause for cause in causes if cause is not None), None)
            # The cause is the first failed input, even if the task failed itself in an earlier run.
            known[task] = first or (task if store.failure(task).exists() else None)
    return known[task]
