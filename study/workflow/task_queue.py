"""The tasks of a run that are ready to start, in their order.

Of the ready tasks, the one with the longest chain of dependent tasks starts first (list scheduling
by critical path). So only short chains remain near the end, and all workers stay busy.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from heapq import heappop, heappush

from study.workflow.task import Task


class TaskQueue:
    """Hands out tasks after their inputs. The cost of a task does not grow with their number.

    Args:
        tasks: all tasks, in an order in which every task comes after its inputs.
        resource: the resource that a task needs, such as `GPU`; empty for none.
    """

    def __init__(self, tasks: Iterable[Task], resource: Callable[[Task], str]) -> None:
        self._tasks = longest_first(list(tasks))
        self._resource = resource
        self._rank = {task: rank for rank, task in enumerate(self._tasks)}
        self._dependents: dict[Task, list[Task]] = defaultdict(list)
        self._missing: dict[Task, int] = {}
        self._ready: dict[str, list[int]] = defaultdict(list)
        self._dropped: set[Task] = set()
        for task in self._tasks:
            inputs = {source for source in task.inputs.values() if source in self._rank}
            self._missing[task] = len(inputs)
            for source in inputs:
                self._dependents[source].append(task)
            if not inputs:
                self.push(task)

    def __bool__(self) -> bool:
        """Whether a task is ready."""
        return any(self._ready.values())

    def push(self, task: Task) -> None:
        """Add a task that is ready, or that shall run once more."""
        heappush(self._ready[self._resource(task)], self._rank[task])

    def pop(self, capacity: Mapping[str, int], running: Iterable[Task]) -> Iterator[Task]:
        """Take the first tasks that fit beside the running ones.

        Args:
            capacity: how many tasks can run, by the resource that they need. Under the empty name,
                how many in all.
            running: the tasks that run.
        """
        used = Counter(map(self._resource, running))
        free = capacity[""] - used.total()
        for resource in sorted(self._ready, reverse=True):  # those that need a resource are first
            available = capacity.get(resource, 0) - used[resource] if resource else free
            for _ in range(min(available, free, len(self._ready[resource]))):
                free -= 1
                yield self._tasks[heappop(self._ready[resource])]

    def finish(self, task: Task) -> None:
        """Note that a task is complete, so that tasks which lack no other input are ready."""
        for dependent in self._dependents[task]:
            self._missing[dependent] -= 1
            if not self._missing[dependent] and dependent not in self._dropped:
                self.push(dependent)

    def drop_dependents(self, task: Task) -> list[Task]:
        """The tasks that lack the task that failed, which do not run, in their order.

        A task is returned once, even if several of its inputs fail.
        """
        new = [one for one in self._dependents[task] if one not in self._dropped]
        self._dropped.update(new)
        return new


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
