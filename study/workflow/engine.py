"""Where stages run: in this process, or side by side on worker processes of Dask.

Both are an ordinary `concurrent.futures.Executor`, so that the scheduler knows nothing of them. A
task's numbers depend on neither: every stage runs on the same number of threads.
"""

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from typing import Any, TypeVar

from study.config.settings import Engine

T = TypeVar("T")

# Worker processes begin with these: a stage's arithmetic keeps to its share of the cores, and
# freed memory is kept for the next batch rather than given back page by page.
MEMORY = {
    "MALLOC_MMAP_MAX_": "0",
    "MALLOC_TRIM_THRESHOLD_": "8589934592",
    "MALLOC_TOP_PAD_": "67108864",
}


class SerialExecutor(Executor):
    """Runs each call at once, in this process."""

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """The call's result or exception, already there."""
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def workers(engine: Engine) -> int:
    """How many tasks run side by side."""
    if engine.kind == "serial":
        return 1
    return engine.workers or max(1, len(os.sched_getaffinity(0)) // engine.threads)


def quiet_rerun() -> None:
    """Rerun writes its own log to the terminal; of what is meant to be so, it need not warn."""
    os.environ.setdefault("RUST_LOG", "error")


@contextmanager
def executor(engine: Engine) -> Iterator[Executor]:
    """Start the engine, and stop it afterwards."""
    quiet_rerun()
    if engine.kind == "serial":
        yield SerialExecutor()
        return
    import dask
    from distributed import Client, LocalCluster, WorkerPlugin

    class Deaf(WorkerPlugin):
        """Ctrl-C reaches every process of the terminal; this one alone decides what it means."""

        name = "deaf"

        def setup(self, worker: Any) -> None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    threads = {name: str(engine.threads) for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS")}
    settings = {
        "distributed.worker.daemon": False,
        "distributed.nanny.pre-spawn-environ": MEMORY | threads,
        # A stage computes for minutes without letting go of the interpreter.
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
            # Any free port: with none, Dask takes one and the same, and a second study complains.
            dashboard_address="127.0.0.1:0",
            memory_limit=0,
            silence_logs="CRITICAL",
        ) as cluster,
        Client(cluster) as client,
    ):
        client.register_plugin(Deaf())
        pool = client.get_executor(pure=False, retries=0)
        try:
            yield pool
        finally:  # whatever still runs is of no use now
            pool.shutdown(wait=False)
