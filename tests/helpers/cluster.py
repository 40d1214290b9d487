"""A Dask cluster of processes of their own, with working folders of their own, on this machine."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from tests.helpers.link import Link
from tests.helpers.running import ROOT

LINKED = 2
"""The worker at the other end of the link of a cluster."""
LONGEST_START = 120.0
"""Seconds for a scheduler or a worker to start on a busy machine."""


class Cluster:
    """A scheduler, and workers named 0, 1, …; all end with the block.

    Args:
        folder: gets the file of the scheduler's address, and the working folders and logs.
        workers: their number.
        worker_ttl: seconds after which the scheduler gives up a worker that shows no life.
        environment: variables of the processes.
        options: of every worker, such as ``--resources GPU=1``.
        protocol: `tcp`, or `tls` with certificates that the environment names.
        link: between the scheduler and the worker `LINKED`.
    """

    def __init__(
        self,
        folder: Path,
        workers: int = 3,
        worker_ttl: float = 300.0,
        environment: dict[str, str] | None = None,
        options: tuple[str, ...] = (),
        protocol: str = "tcp",
        link: Link | None = None,
    ) -> None:
        self.folder, self.options, self._protocol = folder, options, protocol
        self._link = link or Link()
        self._environment = {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"} | (environment or {})
        self._ttl = {"DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": f"{worker_ttl}s"}
        self.workers: dict[int, subprocess.Popen[bytes]] = {}
        self.scheduler = self.start_scheduler()
        for name in range(workers):
            self.start_worker(name)

    def __enter__(self) -> "Cluster":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for process in (*self.workers.values(), self.scheduler):
            kill(process)

    @property
    def address(self) -> str:
        """Of the scheduler."""
        return str(json.loads(self._address_file.read_text())["address"])

    @property
    def flags(self) -> list[str]:
        """Flags of a run on the cluster."""
        return ["--engine.kind=dask", f"--engine.address={self.address}"]

    @property
    def _address_file(self) -> Path:
        return self.folder / "scheduler.json"

    def start_scheduler(self, port: int = 0) -> "subprocess.Popen[bytes]":
        """Start a scheduler, and wait for its address."""
        self._address_file.unlink(missing_ok=True)
        self.scheduler = self._start(
            "scheduler", f"--host={self._protocol}://{self._link.host}", f"--port={port}",
            "--no-dashboard", prefix=(), **self._ttl,
        )  # fmt: skip
        self._wait(self._address_file, self.scheduler)
        return self.scheduler

    def start_worker(self, name: int, *options: str, **environment: str) -> None:
        """Start a worker without a nanny, so that its process is the one that runs stages.

        Args:
            name: a number that no living worker has.
            options: further ones of the worker.
            environment: further variables.
        """
        is_linked = name == LINKED
        process = self._start(
            "worker", "--no-nanny", "--nthreads=1", "--no-dashboard", f"--name={name}",
            "--memory-limit=0", *self.options, *options, log=f"worker-{name}",
            scheduler=self._link.address(self.address) if is_linked else "",
            prefix=self._link.prefix if is_linked else (), **environment,
        )  # fmt: skip
        self.workers[name] = process

    def alive(self) -> list[int]:
        """The names of the workers whose processes live."""
        return [name for name, process in self.workers.items() if process.poll() is None]

    def stop_worker(self, name: int) -> None:
        """Kill a worker for good."""
        kill(self.workers.pop(name))

    def wait_for_end(self, process: int) -> None:
        """Wait until the worker with this process number has ended by itself."""
        for worker in self.workers.values():
            if worker.pid == process:
                worker.wait(timeout=LONGEST_START)

    def wait_for_workers(self, count: int) -> None:
        """Wait until the scheduler knows `count` workers."""
        code = "import sys, distributed; c = distributed.Client(scheduler_file=sys.argv[1])"
        code += f"; c.wait_for_workers({count}, timeout={LONGEST_START}); c.close()"
        subprocess.run([sys.executable, "-c", code, str(self._address_file)], check=True)

    def _start(
        self,
        kind: str,
        *arguments: str,
        log: str = "",
        scheduler: str = "",
        prefix: tuple[str, ...] = (),
        **environment: str,
    ) -> "subprocess.Popen[bytes]":
        folder = self.folder / (log or kind)
        folder.mkdir(parents=True, exist_ok=True)
        with (self.folder / f"{log or kind}.log").open("ab") as output:
            command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *arguments]
            found = scheduler or f"--scheduler-file={self._address_file}"
            return subprocess.Popen(
                [*prefix, *command, found],
                cwd=folder,
                env=os.environ | self._environment | environment,
                stdout=output,
                stderr=output,
                start_new_session=True,
            )

    def _wait(self, path: Path, process: Any) -> None:
        deadline = time.monotonic() + LONGEST_START
        # Dask does not write the file at once.
        while not path.exists() or not path.read_bytes().endswith(b"}"):
            assert process.poll() is None, "it ended at its start"
            assert time.monotonic() < deadline
            time.sleep(0.05)


def kill(process: "subprocess.Popen[Any]") -> None:
    """Kill a process and those that it started."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGCONT)
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
