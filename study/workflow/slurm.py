"""Workers in jobs of SLURM, which dask-jobqueue submits.

The scheduler of Dask runs in this process. A job starts `engine.cores` / `engine.threads` workers,
which connect to it, encrypted, with certificates in the folder of the store. Workers end by
themselves before the walltime of their job. `Jobs` asks for jobs while tasks are left, and ends
those without a task. The adaptive scaling of Dask does not know that the workers of a job end
together (https://github.com/dask/dask-jobqueue/issues/498), so it is not used.
"""

import math
import os
import shlex
import shutil
import subprocess
import time
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from study.common.errors import BadInput, StudyError
from study.config.jobs import walltime_seconds, workers_of_job
from study.config.settings import Engine
from study.workflow.cluster import MEMORY, SETTINGS, DaskWorkers
from study.workflow.fitness import Expected, shared
from study.workflow.task import Task

MARGIN = 300
"""Seconds before the end of the walltime at which workers end; half of a short one."""
POLL = 5.0
"""Seconds between two polls of the jobs."""
IDLE = 60.0
"""Seconds without a task after which a job is ended, if others are enough."""
EARLY = 5.0
"""Seconds of connection after which a job counts as one that has started."""
CERTIFICATES = ".dask-jobqueue.worker.*"
"""The files with the certificates of the workers, in the folder `LOGS`."""
LOGS = "slurm"
"""The folder of the output of jobs, in that of the store."""


class Jobs:
    """Keeps as many jobs as the tasks need.

    Args:
        cluster: of dask-jobqueue.
        most: jobs at a time.
        size: workers of a job.
        attempts: jobs in a row that may end as soon as they start.
        logs: folder of their output.
    """

    def __init__(self, cluster: Any, most: int, size: int, attempts: int, logs: Path) -> None:
        self._cluster, self._most, self._size = cluster, most, size
        self._attempts, self._logs = attempts, logs
        self._connected_at: dict[str, float] = {}
        self._busy_at: dict[str, float] = {}
        self._ended_early = 0

    def adjust(self, pending: int, processing: Mapping[str, int]) -> None:
        """Submit and end jobs.

        Args:
            pending: tasks that run or shall run.
            processing: the number of tasks of each connected worker, by its name.

        Raises:
            StudyError: SLURM accepts no job, or jobs end as soon as they start.
        """
        now, tasks = time.monotonic(), self._tasks(processing)
        for job, count in tasks.items():
            if now - self._connected_at.setdefault(job, now) > EARLY:
                self._ended_early = 0
            if count or job not in self._busy_at:
                self._busy_at[job] = now
        self._close([job for job in self._jobs() if self._has_ended(job, tasks, now)])
        wanted = min(self._most, math.ceil(pending / self._size))
        idle = [
            job
            for job, count in tasks.items()
            if job in self._jobs() and not count and now - self._busy_at[job] > IDLE
        ]
        self._close(idle[: max(0, len(self._jobs()) - wanted)])
        if len(self._jobs()) < wanted:
            self._submit(wanted)

    def _jobs(self) -> list[str]:
        """The names of the jobs that were submitted and are not known to have ended."""
        return list(self._cluster.worker_spec)

    def _tasks(self, processing: Mapping[str, int]) -> dict[str, int]:
        """The number of tasks of each job with a connected worker."""
        tasks: dict[str, int] = {}
        for worker, count in processing.items():
            job = worker if self._size == 1 else worker.rpartition("-")[0]
            tasks[job] = tasks.get(job, 0) + count
        return tasks

    def _has_ended(self, job: str, tasks: Mapping[str, int], now: float) -> bool:
        """Whether a job has ended: its workers have left, or SLURM does not know it any more.

        Raises:
            StudyError: too many jobs in a row ended as soon as they started.
        """
        if job in tasks:
            return False
        if job not in self._connected_at:
            is_early = has_ended = _is_gone(getattr(self._cluster.workers.get(job), "job_id", ""))
        else:
            has_ended, is_early = True, now - self._connected_at[job] < EARLY
        self._ended_early += is_early
        if self._ended_early > self._attempts:
            raise StudyError(
                f"{self._ended_early} jobs of SLURM ended as soon as they started; their output is "
                f"in {self._logs}; check engine.prologue and engine.interface"
            )
        return has_ended

    def _submit(self, jobs: int) -> None:
        async def submit() -> None:
            self._cluster.scale(jobs=jobs)
            await self._cluster

        try:
            self._cluster.sync(submit)
        except (RuntimeError, ValueError, OSError) as error:
            reason = " ".join(str(error).partition("stderr:")[2].split() or str(error).split())
            raise StudyError(f"sbatch accepts no job: {reason[:300]}") from None

    def _close(self, jobs: list[str]) -> None:
        for job in jobs:  # the next job may have the same name
            self._connected_at.pop(job, None)
            self._busy_at.pop(job, None)
        if jobs:
            self._cluster.sync(self._cluster.scale_down, jobs)


class SlurmWorkers(DaskWorkers):
    """The workers of all jobs, now or later.

    Args:
        client: of Dask.
        jobs: the jobs.
        most: tasks at a time.
        expected: what workers must have in common with this process.
    """

    def __init__(self, client: Any, jobs: Jobs, most: int, expected: Expected) -> None:
        self._jobs, self._pending, self._polled = jobs, set[Future[Any]](), 0.0
        super().__init__(client, most, expected)

    def capacity(self) -> Mapping[str, int]:
        """The number of workers that there are, or may be; asks for jobs."""
        self._check_connection()
        self._pending = {future for future in self._pending if not future.done()}
        if self._pending and time.monotonic() - self._polled > POLL:
            self._poll()
        return {"": self._most}

    def resource(self, task: Task) -> str:
        """None: all jobs are equal."""
        return ""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """See `DaskWorkers`."""
        future = super().submit(fn, *args, **kwargs)
        self._pending.add(future)
        return future

    def _poll(self) -> None:
        try:
            workers = self._client.scheduler_info(n_workers=-1)["workers"]
            processing = self._client.processing()
        except (OSError, RuntimeError):
            raise self._lost() from None
        names = {info["name"]: len(processing.get(at, ())) for at, info in workers.items()}
        self._jobs.adjust(len(self._pending), names)
        self._polled = time.monotonic()


@contextmanager
def submitted(engine: Engine, root: Path, tasks: Iterable[Task]) -> Iterator[SlurmWorkers]:
    """Workers in jobs of SLURM, which end with this process.

    Args:
        engine: the settings.
        root: folder of the store, which all machines share.
        tasks: those of the run.

    Raises:
        BadInput: there is no SLURM here, or a package is missing.
    """
    import dask
    from distributed import Client
    from distributed.security import Security

    if shutil.which("sbatch") is None:
        raise BadInput(
            "engine.kind: got 'slurm', and there is no sbatch here; run it on a machine from which "
            "jobs can be submitted, or use --engine.kind dask"
        )
    try:
        from dask_jobqueue.slurm import SLURMCluster

        security = Security.temporary()
    except ImportError as error:
        raise BadInput(
            f"engine.kind: slurm needs {error.name or 'cryptography'}: pip install -e '.[cluster]'"
        ) from None
    (root / LOGS).mkdir(exist_ok=True)
    for path in (root / LOGS).glob(CERTIFICATES):  # of a run that was killed
        path.unlink()
    size = workers_of_job(engine)
    most = engine.workers or size
    # `Jobs` ends lost workers. Dask would end the next job of the same name.
    settings = SETTINGS | {"distributed.deploy.lost-worker-timeout": "1000 days"}
    with (
        shared(root, tasks) as expected,
        dask.config.set(settings),
        SLURMCluster(security=security, **job_options(engine, root)) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        jobs = Jobs(cluster, math.ceil(most / size), size, engine.retries, root / LOGS)
        workers = SlurmWorkers(client, jobs, most, expected)
        try:
            yield workers
        finally:  # results of running tasks are no longer needed
            workers.shutdown(wait=False)
            for name in ("ca_file", "cert", "key"):
                getattr(cluster, f"_job_{name}").close()  # which removes the file


def job_options(engine: Engine, root: Path) -> dict[str, Any]:
    """The arguments of `dask_jobqueue.SLURMCluster`."""
    size, walltime = workers_of_job(engine), walltime_seconds(engine)
    lifetime = walltime - min(MARGIN, walltime // 2)
    return {
        "queue": engine.partition or None,
        "account": engine.account or None,
        "walltime": engine.walltime,
        "cores": size,  # threads of Dask: one for each worker
        "processes": size,
        "job_cpu": engine.cores,
        "memory": engine.memory,
        "interface": engine.interface or None,
        "job_script_prologue": [
            *engine.prologue,
            f"cd {shlex.quote(os.getcwd())}",
            *(
                f"export {name}={shlex.quote(value)}"
                for name, value in _environment(engine).items()
            ),
        ],
        "job_extra_directives": list(engine.directives),
        "worker_extra_args": [
            *("--lifetime", f"{lifetime}s"),
            "--no-dashboard",
            *("--memory-limit", "0"),  # SLURM limits the memory of the job
        ],
        "log_directory": str(root / LOGS),
        "shared_temp_directory": str(root / LOGS),
        "scheduler_options": {"dashboard_address": "127.0.0.1:0", "port": 0},
        "silence_logs": "CRITICAL",
    }


def _environment(engine: Engine) -> dict[str, str]:
    """Variables of the workers of a job."""
    return MEMORY | {
        "OMP_NUM_THREADS": str(engine.threads),
        "MKL_NUM_THREADS": str(engine.threads),
        "OPENBLAS_NUM_THREADS": "1",
        "DASK_DISTRIBUTED__WORKER__DAEMON": "False",
        "DASK_DISTRIBUTED__ADMIN__TICK__LIMIT": "1 hour",
        "DASK_LOGGING__DISTRIBUTED": "warning",
        "PYTHONPATH": os.pathsep.join(filter(None, [os.getcwd(), os.environ.get("PYTHONPATH")])),
    }


def _is_gone(job_id: str) -> bool:
    """Whether SLURM does not know the job any more; False if that is unknown."""
    if not job_id or shutil.which("squeue") is None:
        return False
    with suppress(OSError, subprocess.TimeoutExpired):
        command = ["squeue", "--noheader", "--job", job_id, "--format", "%T"]
        answer = subprocess.run(
            command, capture_output=True, text=True, encoding="utf-8", timeout=30
        )
        is_unknown = "Invalid job id" in answer.stderr
        return is_unknown or (answer.returncode == 0 and not answer.stdout.strip())
    return False
