"""Where stages run: this process, local worker processes of Dask, or those of a Dask cluster.

All have the interface of `study.workflow.workers`, which is all that the scheduler uses. Results do
not depend on the engine, since a stage uses `engine.threads` threads everywhere. The workers of a
cluster need the processors and the C compiler of this machine for equal bytes.
"""

import os
import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex
from typing import Any

from study.common.errors import BadInput
from study.config.jobs import workers_of_job
from study.config.settings import Engine
from study.workflow.cluster import MEMORY, SETTINGS, DaskWorkers, connect
from study.workflow.lease import Terms
from study.workflow.task import Task
from study.workflow.workers import SerialWorkers, Workers


def workers(engine: Engine) -> int:
    """The number of tasks that run in parallel; 0 for as many as a cluster has workers."""
    if engine.kind == "serial":
        return 1
    if engine.address:
        return engine.workers
    if engine.kind == "slurm":
        return engine.workers or workers_of_job(engine)
    return engine.workers or max(1, cores() // engine.threads)


def cores() -> int:
    """CPU cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # Linux: containers and `taskset` restrict it
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def terms(engine: Engine) -> Terms:
    """The terms of the leases of a new run."""
    return Terms(float(engine.lease), engine.retries, token_hex(6))


@contextmanager
def start(engine: Engine, root: Path, tasks: Iterable[Task]) -> Iterator[Workers]:
    """Start the engine, and stop it on exit.

    Args:
        engine: the settings.
        root: folder of the store.
        tasks: those of the run.

    Raises:
        BadInput: a file of Dask's settings, of the user or the machine, is damaged; or a cluster
            cannot run the tasks.
    """
    if engine.kind == "serial":
        yield SerialWorkers()
        return
    try:
        import dask
    except ValueError as error:
        raise BadInput(
            f"Dask cannot be started: {' '.join(str(error).split())[:200]}; mend that file, or use "
            "--engine.kind serial"
        ) from None
    dask.config.refresh(paths=[], env={})  # its defaults, without files and variables
    if engine.kind == "slurm":
        from study.workflow.slurm import submitted

        with submitted(engine, root, tasks) as pool:
            yield pool
        return
    with connect(engine, root, tasks) if engine.address else _local(engine) as pool:
        yield pool


@contextmanager
def _local(engine: Engine) -> Iterator[DaskWorkers]:
    """Worker processes of this machine, which end with this process."""
    import dask
    from distributed import Client, LocalCluster, WorkerPlugin

    class IgnoreInterrupts(WorkerPlugin):
        """Ctrl-C reaches every process of the terminal. Only the main process handles it."""

        name = "ignore-interrupts"

        def setup(self, worker: Any) -> None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    threads = {name: str(engine.threads) for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS")}
    settings = SETTINGS | {
        "distributed.worker.daemon": False,
        "distributed.nanny.pre-spawn-environ": MEMORY | threads,
        "distributed.worker.memory.terminate": False,
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
        pool = DaskWorkers(client, workers(engine))
        try:
            yield pool
        finally:  # results of running tasks are no longer needed
            pool.shutdown(wait=False)
