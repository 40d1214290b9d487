"""The workers of a Dask cluster: those of this machine, or those of an existing scheduler.

Only tasks and outcomes, some kilobytes each, go through the scheduler. Workers read and write the
folders of the store on a shared file system.

With an address, the section `distributed.comm` of Dask's settings counts, from the user's and the
machine's files and from ``DASK_DISTRIBUTED__COMM__*``: certificates (TLS), timeouts, compression.
It says how to connect. All other settings of Dask are its defaults (`study.common.isolation`).
"""

import logging
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from study.common.errors import BadInput, StudyError
from study.config.settings import Engine
from study.workflow.fitness import Expected, UnfitWorker, shared, why_unfit
from study.workflow.task import Task
from study.workflow.workers import Workers

T = TypeVar("T")

SETTINGS = {
    # A stage may hold the interpreter lock for minutes.
    "distributed.scheduler.worker-ttl": "1 hour",
    "distributed.scheduler.allowed-failures": 0,
    "distributed.admin.tick.limit": "1 hour",
    "logging.distributed": "critical",
}
"""Settings of Dask where its scheduler runs in this process."""
# By default glibc's malloc returns freed memory to the system page by page, which is slow. With
# these values the process uses the memory for the next batch.
MEMORY = {
    "MALLOC_MMAP_MAX_": "0",
    "MALLOC_TRIM_THRESHOLD_": "8589934592",
    "MALLOC_TOP_PAD_": "67108864",
}
"""Variables of worker processes."""

GPU = "GPU"
"""The resource that a worker with a GPU offers: ``dask worker ADDRESS --resources GPU=1``."""
ASK_AFTER = 2.0
"""Seconds after which the scheduler is asked again how many workers there are."""


class DaskWorkers(Workers):
    """Runs calls on the workers of a Dask client.

    Args:
        client: the client.
        most: tasks at a time; 0 for as many as there are workers.
        expected: what workers of a cluster must have in common with this process; None for workers
            that this process has started.
    """

    def __init__(self, client: Any, most: int, expected: Expected | None = None) -> None:
        self._client, self._most, self._expected = client, most, expected
        self._capacity: tuple[float, Mapping[str, int]] = (0.0, {})
        self._plain = client.get_executor(pure=False, retries=0)
        self._on_gpu = client.get_executor(pure=False, retries=0, resources={GPU: 1})
        self._has_gpu = GPU in self.capacity()

    def capacity(self) -> Mapping[str, int]:
        """The number of workers, and of those that offer a GPU.

        Raises:
            StudyError: the scheduler was lost.
        """
        if self._expected is None:
            return {"": self._most}
        self._check_connection()
        asked, capacity = self._capacity
        if not capacity or time.monotonic() - asked > ASK_AFTER:
            capacity = self._ask_capacity()
            self._capacity = time.monotonic(), capacity
        return capacity

    def _ask_capacity(self) -> Mapping[str, int]:
        try:
            workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
        except (OSError, RuntimeError):
            raise self._lost() from None
        count = max(1, min(len(workers), self._most or len(workers)))
        with_gpu = sum(GPU in worker["resources"] for worker in workers)
        return {"": count, GPU: with_gpu} if with_gpu else {"": count}

    def resource(self, task: Task) -> str:
        """`GPU` for a task that uses one, see `accelerator`.

        With the accelerator `auto` it runs without a GPU if no worker offered one at the start.
        """
        wanted = accelerator(task)
        return GPU if wanted == "gpu" or (wanted == "auto" and self._has_gpu) else ""

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Run a call whose first argument is a task on a worker with the task's resource.

        Raises:
            StudyError: the scheduler was lost.
        """
        self._check_connection()
        pool = self._on_gpu if self.resource(args[0]) else self._plain
        future: Future[T]
        if self._expected is None:
            future = pool.submit(fn, *args, **kwargs)
        else:
            future = pool.submit(_guarded, self._expected, fn, *args, **kwargs)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Forget the tasks that are not complete. What a worker runs at the moment ends there."""
        for pool in (self._plain, self._on_gpu):
            pool.shutdown(wait=wait)

    def _check_connection(self) -> None:
        if self._client.status != "running":
            raise self._lost()

    def _lost(self) -> StudyError:
        return StudyError(
            f"the Dask scheduler at {self._client.scheduler.address} was lost; complete stages are "
            "kept: run the same command again when there is a scheduler"
        )


def accelerator(task: Task) -> str | None:
    """The accelerator that the task asks for; None for a task that runs on any worker.

    Forecasts with `auto` are made on any worker, so that they do not wait for a GPU.
    """
    setting = str(task.settings.get("accelerator", "auto"))
    if task.stage == "ensemble":
        return setting
    if task.stage in ("evaluate", "validate"):
        has_network = "trained" in task.inputs or "ensemble" in task.inputs
        return setting if setting == "gpu" and has_network else None
    if task.stage not in ("tune", "trial", "train"):
        return None
    fit: Mapping[str, Any] = task.settings.get("fit", task.settings)
    return str(fit.get("model_settings", {}).get("train", {}).get("accelerator", "auto"))


@contextmanager
def connect(engine: Engine, root: Path, tasks: Iterable[Task]) -> Iterator[DaskWorkers]:
    """The workers of the scheduler at `engine.address`.

    Args:
        engine: the address, and the number of workers at most.
        root: folder of the store, which the workers share.
        tasks: those of the run.

    Raises:
        BadInput: there is no scheduler, or a worker cannot run the stages.
    """
    import dask
    from distributed import Client

    of_user = dask.config.get("distributed.comm", {}, config=dask.config.collect())
    connection = dask.config.merge(dask.config.get("distributed.comm"), of_user)
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    tasks, address = list(tasks), engine.address
    with dask.config.set({"distributed.comm": connection}):
        try:
            with warnings.catch_warnings(action="ignore"):  # other versions are an error below
                client = Client(address, set_as_default=False)
        except Exception as error:  # TLS and versions have errors of many kinds
            raise BadInput(_why_no_scheduler(address, error)) from None
        try:
            with shared(root, tasks) as expected:
                _check_scheduler(client, address, expected)
                _check_workers(client, expected)
                workers = DaskWorkers(client, engine.workers, expected)
                _check_gpu(workers, address, tasks)
                yield workers
                workers.shutdown(wait=False)
        finally:
            client.close(timeout=2)


def _guarded(expected: Expected, fn: Callable[..., T], *args: Any, **kwargs: Any) -> T:
    """On a worker: call the function if the worker can run stages.

    Raises:
        UnfitWorker: it cannot.
    """
    from distributed import get_worker

    worker = get_worker()
    why = why_unfit(expected, worker.state.nthreads)
    if why is not None:
        raise UnfitWorker(f"worker {worker.address}: {why}")
    return fn(*args, **kwargs)


def _ask(expected: Expected, dask_worker: Any) -> str | None:
    """On a worker: why it cannot run stages."""
    return why_unfit(expected, dask_worker.state.nthreads)


def _check_scheduler(client: Any, address: str, expected: Expected) -> None:
    found = client.get_versions()["scheduler"]["packages"]["distributed"]
    wanted = expected.packages["distributed"]
    if found != wanted:
        raise BadInput(
            f"engine.address: the scheduler at {address} has distributed {found}, and this process "
            f"{wanted}; install {wanted} there"
        )


def _check_workers(client: Any, expected: Expected) -> None:
    """Ask all workers. Those that come later are asked when they get a task."""
    answers = client.run(_ask, expected, on_error="return")
    problems = {
        worker: _in_line(answer) if isinstance(answer, Exception) else str(answer)
        for worker, answer in answers.items()
        if answer is not None
    }
    if problems:
        worker, why = next(iter(problems.items()))
        others = f" ({len(problems)} of {len(answers)} workers have problems)"
        raise BadInput(
            f"engine.address: worker {worker}: {why}{others if len(problems) > 1 else ''}"
        )


def _check_gpu(workers: DaskWorkers, address: str, tasks: Iterable[Task]) -> None:
    if GPU not in workers.capacity() and any(accelerator(task) == "gpu" for task in tasks):
        raise BadInput(
            f"train.accelerator: got 'gpu', and no worker of {address} offers one; start one with "
            "`dask worker --resources GPU=1`, or give auto"
        )


def _in_line(error: Exception) -> str:
    if isinstance(error, ModuleNotFoundError):
        return f"it cannot import the study ({error}); install it there"
    return f"{type(error).__name__}: {' '.join(str(error).split())}"[:200]


def _why_no_scheduler(address: str, error: Exception) -> str:
    reason = _in_line(error)
    if address.startswith("tls:") and isinstance(error, TypeError | RuntimeError):
        return (
            f"engine.address: {address} needs certificates in Dask's settings, "
            f"distributed.comm.tls ({reason})"
        )
    return (
        f"engine.address: no Dask scheduler answers at {address} ({reason}); start one with "
        "`dask scheduler`"
    )
