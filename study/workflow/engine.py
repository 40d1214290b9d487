"""The executors of stages: this process, or parallel worker processes of Dask.

Both have the interface of `concurrent.futures.Executor`, which is all that the scheduler uses.
Results do not depend on the engine, since a stage uses `engine.threads` threads in both.
"""

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from typing import Any, TypeVar

from study.common.errors import BadInput
from study.config.settings import Engine

T = TypeVar("T")

# Environment of the worker processes. By default glibc's malloc returns freed memory to the system
# page by page, which is slow. With these values the process uses the memory for the next batch.
MEMORY = {
    "MALLOC_MMAP_MAX_": "0",
    "MALLOC_TRIM_THRESHOLD_": "8589934592",
    "MALLOC_TOP_PAD_": "67108864",
}


class SerialExecutor(Executor):
    """Runs each call immediately, in this process."""

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """A completed future with the result or the exception of the call."""
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def workers(engine: Engine) -> int:
    """The number of tasks that run in parallel."""
    if engine.kind == "serial":
        return 1
    return engine.workers or max(1, cores() // engine.threads)


def cores() -> int:
    """CPU cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # Linux: containers and `taskset` restrict it
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def executor(engine: Engine) -> Iterator[Executor]:
    """Start the engine, and stop it on exit.

    Raises:
        BadInput: a file of Dask's settings, of the user or the machine, is damaged.
    """
    if engine.kind == "serial":
        yield SerialExecutor()
        return
    try:
        import dask
        from distributed import Client, LocalCluster, WorkerPlugin
    except ValueError as error:
        raise BadInput(
            f"Dask cannot be started: {' '.join(str(error).split())[:200]}; mend that file, or use "
            "--engine.kind serial"
        ) from None
    dask.config.refresh(paths=[], env={})  # its defaults, without files and variables

    class IgnoreInterrupts(WorkerPlugin):
        """Ctrl-C reaches every process of the terminal. Only the main process handles it."""

        name = "ignore-interrupts"

        def setup(self, worker: Any) -> None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    threads = {name: str(engine.threads) for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS")}
    settings = {
        "distributed.worker.daemon": False,
        "distributed.nanny.pre-spawn-environ": MEMORY | threads,
        # A stage may hold the interpreter lock for minutes.
        "distributed.scheduler.worker-ttl": "1 hour",
        "distributed.scheduler.allowed-failures": 0,
        "distributed.worker.memory.terminate": False,
        "distributed.admin.tick.limit": "1 hour",
        "logging.distributed": "critical",
    }
    with (
        dask.config.set(settings),
        LocalCluster(
            n_workers=workers(engine),
            threads_per_worker=1,
            processes=True,
            # Port 0 is any free port. Two studies at the same time cannot share the default port.
            dashboard_address="127.0.0.1:0",
            memory_limit=0,
            silence_logs="CRITICAL",
        ) as cluster,
        Client(cluster) as client,
    ):
        client.register_plugin(IgnoreInterrupts())
        pool = client.get_executor(pure=False, retries=0)
        try:
            yield pool
        finally:  # results of running tasks are no longer needed
            pool.shutdown(wait=False)
