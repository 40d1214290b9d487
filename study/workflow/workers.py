"""Workers: what `study.workflow.scheduler` needs of an engine, and the engine of this process."""

from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from typing import Any, TypeVar

from study.workflow.task import Task

T = TypeVar("T")


class Workers(Executor):
    """An executor that knows how many tasks it can run at a time."""

    def capacity(self) -> Mapping[str, int]:
        """How many tasks can run at a time, by the resource that they need.

        Under the empty name stands how many can run in all, at least 1.

        Raises:
            StudyError: the workers cannot be reached.
        """
        raise NotImplementedError

    def resource(self, task: Task) -> str:
        """The resource that a task needs, such as `GPU`; empty for none."""
        return ""


class SerialWorkers(Workers):
    """Runs each call immediately, in this process."""

    def capacity(self) -> Mapping[str, int]:
        """One task at a time."""
        return {"": 1}

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """A completed future with the result or the exception of the call."""
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future
