"""Run one task in this process: its log, its threads and its folder."""

import importlib
import logging
import os
import random
import socket
import traceback
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol, TextIO

import numpy as np

from study.common.errors import explain
from study.common.progress import Progress
from study.config.convert import from_json
from study.config.stage_settings import STAGES
from study.workflow.checks import check_classes
from study.workflow.lease import USUAL, Holder, Lease, LeaseLost, Terms, hold
from study.workflow.meter import Meter
from study.workflow.store import Store
from study.workflow.task import Task


class Stage(Protocol):
    """The module of a stage, `study.stages.NAME`.

    `run` is a pure function from files to files: the same settings and inputs give the same bytes.
    With ``RESUMABLE = True``, `out` may hold the files of a stopped run of the same task.
    """

    @staticmethod
    def run(settings: Any, inputs: Mapping[str, Path], out: Path, progress: Progress) -> None:
        """Read the folders `inputs`, write into the folder `out`.

        Args:
            settings: the stage's dataclass of `study.config.stage_settings`.
            inputs: complete folders of earlier stages, by name.
            out: folder to write into.
            progress: called with the fraction done.
        """
        ...


class InputMissing(Exception):
    """This machine does not see the folder of an earlier stage."""


@dataclass(frozen=True)
class Outcome:
    """How a task ended.

    Attributes:
        task: the task.
        seconds: wall time.
        error: one line; the log has the traceback. None if the task succeeded.
    """

    task: Task
    seconds: float
    error: str | None = None


class LeasedProgress(Progress):
    """The progress of a stage, which ends the stage if its lease is lost.

    Args:
        path: the file to write.
        lease: of the stage.
    """

    def __init__(self, path: Path, lease: Lease) -> None:
        super().__init__(path)
        self.lease = lease

    def _report(self, fraction: float, message: str) -> None:
        self.lease.check()
        with suppress(FileNotFoundError):  # another holder has written at the same moment
            super()._report(fraction, message)


def execute(task: Task, root: Path, threads: int, terms: Terms = USUAL) -> Outcome:
    """Run the task and complete its folder. An exception of the stage becomes an `Outcome`.

    Nothing runs if another process completes the folder while this one waits for the lease.

    Args:
        task: the task.
        root: folder of the store.
        threads: CPU threads of the stage.
        terms: of the lease.

    Raises:
        LeaseLost: this process was stopped for so long that another one runs the task.
        InputMissing: this machine does not see the folder of an earlier stage.
    """
    store = Store(root)
    began, meter = datetime.now(UTC), Meter()
    progress = Progress(store.progress(task))

    def waits(holder: Holder) -> None:
        progress(0.0, f"waits for {holder.host}, process {holder.process}")

    try:
        with hold(store.lease(task), terms, waits) as lease:
            if store.is_complete(task):
                return Outcome(task, 0.0)
            if lease.attempt > terms.retries + 1:
                return Outcome(task, 0.0, f"its worker was lost {lease.attempt - 1} times")
            for source in task.inputs.values():
                if not store.is_visible(source):
                    raise InputMissing(f"no {store.folder(source)} on {socket.gethostname()}")
            error = _run_logged(task, store, threads, lease, began, meter)
    except OSError as problem:  # the lease cannot be written
        error = explain(problem)
    finally:
        store.progress(task).unlink(missing_ok=True)
    return Outcome(task, meter.read()["seconds"], error)


def _run_logged(
    task: Task, store: Store, threads: int, lease: Lease, began: datetime, meter: Meter
) -> str | None:
    """Run the task with a log of its own.

    Returns:
        the error in one line; None if the folder is complete.

    Raises:
        LeaseLost: another process runs the task; nothing is left of this attempt.
    """
    log = store.log(task)
    log.parent.mkdir(parents=True, exist_ok=True)
    log.unlink(missing_ok=True)  # a holder that was lost may still write to the old one
    progress = LeasedProgress(store.progress(task), lease)
    with _logged(log):
        try:
            prepare(task.plugins, threads)
            lease.verify()  # `begin` removes the folders of other attempts
            out = store.begin(task, getattr(_module(task), "RESUMABLE", False), lease.token)
            inputs = {name: store.folder(source) for name, source in task.inputs.items()}
            progress(0.0, "started")
            check_classes(task, inputs)
            run_stage(task, inputs, out, progress)
            began_at = began.isoformat(timespec="milliseconds")
            runtime, device = _runtime()
            timing = {"began": began_at, "threads": threads} | meter.read() | device
            store.finish(task, timing, runtime, lease.token, lease.verify)
        except Exception as problem:
            try:
                lease.verify()  # without the lease, the error may come from the new holder
            except LeaseLost:
                store.discard(task, lease.token)
                raise
            except OSError:
                pass
            if store.is_complete(task):  # an earlier holder has completed it meanwhile
                store.discard(task, lease.token)
                return None
            with suppress(OSError):  # the disk may be full
                traceback.print_exc()
            return f"{type(problem).__name__}: {' '.join(str(problem).split())}"[:300]
    return None


def run_stage(task: Task, inputs: Mapping[str, Path], out: Path, progress: Progress) -> None:
    """Run the task's stage on the folders `inputs`, into the folder `out`. Call `prepare` first."""
    settings: Any = from_json(STAGES[task.stage], {**task.settings, **task.services})
    _module(task).run(settings, inputs, out, progress)


def prepare(plugins: tuple[str, ...], threads: int) -> None:
    """Put this process into the same state before every task: plugins, threads and seeds.

    Args:
        plugins: modules to import.
        threads: CPU threads of torch.
    """
    import torch

    from study.models.runtime import forget_uses

    forget_uses()
    for plugin in plugins:
        importlib.import_module(plugin)
    torch.set_num_threads(threads)
    # Without it the products of a GPU depend on which of its parts are free.
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    torch.use_deterministic_algorithms(True, warn_only=True)
    # In deterministic mode torch also fills new memory with NaN, which takes time.
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002 - Optuna and Lightning may use the global generator
    torch.manual_seed(0)


def _runtime() -> tuple[Mapping[str, Any], dict[str, str]]:
    """The runtime for the manifest, and the entry of the devices in ``timing.json``."""
    from study.models.runtime import runtime, uses  # torch takes seconds to import

    return runtime(), {"device": uses()} if uses() else {}


def _module(task: Task) -> Stage:
    module: Any = importlib.import_module(f"study.stages.{task.stage}")
    return module


@contextmanager
def _log_file(path: Path) -> Iterator[TextIO]:
    """A new log. An error on closing (a full disk) does not replace the error of the task."""
    file = path.open("w", buffering=1, encoding="utf-8", errors="backslashreplace")
    try:
        yield file
    finally:
        with suppress(OSError):
            file.close()


@contextmanager
def _logged(path: Path) -> Iterator[None]:
    """Write everything that the task prints or logs to the file `path`."""
    with _log_file(path) as file:
        handler = logging.StreamHandler(file)
        handler.setFormatter(logging.Formatter("%(asctime)s %(name)s: %(message)s"))
        loggers = [logging.getLogger(name) for name in ("", "lightning", "lightning.pytorch")]
        previous = [(logger, logger.handlers[:], logger.propagate) for logger in loggers]
        for logger in loggers:
            logger.handlers = [handler] if logger.name == "root" else []
            logger.propagate = True
        try:
            with redirect_stdout(file), redirect_stderr(file), warnings.catch_warnings():
                yield
        finally:
            for logger, handlers, propagate in previous:
                logger.handlers, logger.propagate = handlers, propagate
