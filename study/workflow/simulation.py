"""How long tasks take on many workers: the scheduler's order, simulated with expected durations."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from heapq import heappop, heappush

from study.workflow.task import Task
from study.workflow.task_queue import longest_first


@dataclass(frozen=True)
class Forecast:
    """How tasks would run.

    Attributes:
        seconds: from the first start to the last end.
        busy: share of that time, of all workers, in which a worker runs a task.
    """

    seconds: float
    busy: float


def simulate(tasks: Iterable[Task], seconds: Mapping[Task, float], workers: int) -> Forecast:
    """Run the tasks in simulated time.

    Args:
        tasks: in an order in which every task comes after its inputs. Other inputs are complete.
        seconds: the expected duration of each task.
        workers: number of tasks that run at a time.
    """
    ordered = longest_first(list(tasks))
    rank = {task: index for index, task in enumerate(ordered)}
    missing = {task: _inputs(task, rank) for task in ordered}
    dependents: dict[Task, list[Task]] = {}
    for task, inputs in missing.items():
        for source in inputs:
            dependents.setdefault(source, []).append(task)
    ready = [rank[task] for task, inputs in missing.items() if not inputs]
    running: list[tuple[float, int]] = []
    now = 0.0
    while ready or running:
        while ready and len(running) < workers:
            index = heappop(ready)
            heappush(running, (now + seconds[ordered[index]], index))
        now, index = heappop(running)
        for task in dependents.get(ordered[index], []):
            missing[task].discard(ordered[index])
            if not missing[task]:
                heappush(ready, rank[task])
    total = sum(seconds[task] for task in ordered)
    return Forecast(now, total / (now * workers) if now else 0.0)


def critical_path(tasks: Iterable[Task], seconds: Mapping[Task, float]) -> list[Task]:
    """The longest chain of dependent tasks: a lower bound on the duration for any workers.

    Args:
        tasks: in an order in which every task comes after its inputs.
        seconds: the expected duration of each task.
    """
    end: dict[Task, float] = {}
    previous: dict[Task, Task | None] = {}
    for task in tasks:
        inputs = _inputs(task, end)
        before = max(inputs, key=end.__getitem__, default=None)
        previous[task] = before
        end[task] = seconds[task] + (end[before] if before is not None else 0.0)
    path: list[Task] = []
    last = max(end, key=end.__getitem__, default=None)
    while last is not None:
        path.append(last)
        last = previous[last]
    return path[::-1]


def _inputs(task: Task, others: Iterable[Task]) -> set[Task]:
    """The inputs of the task that are among others."""
    return {source for source in task.inputs.values() if source in others}
