"""How long tasks take on many workers: the scheduler's order, simulated with expected durations."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count

from study.workflow.task import Task
from study.workflow.task_queue import TaskQueue


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
    tasks = list(tasks)
    queue = TaskQueue(tasks, lambda _: "")
    running: list[tuple[float, int, Task]] = []
    now, started = 0.0, count()
    while queue or running:
        for task in queue.pop({"": workers}, [task for *_, task in running]):
            heappush(running, (now + seconds[task], next(started), task))
        now, _, ended = heappop(running)
        queue.finish(ended)
    total = sum(seconds[task] for task in tasks)
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
        inputs = [source for source in task.inputs.values() if source in end]
        before = max(inputs, key=end.__getitem__, default=None)
        previous[task] = before
        end[task] = seconds[task] + (end[before] if before is not None else 0.0)
    path: list[Task] = []
    last = max(end, key=end.__getitem__, default=None)
    while last is not None:
        path.append(last)
        last = previous[last]
    return path[::-1]
