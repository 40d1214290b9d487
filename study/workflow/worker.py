"""Run one task: in whatever process the engine chose, with its log, its threads and its folder."""

import importlib
import logging
import random
import traceback
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from study.common.progress import Progress
from study.workflow.meter import Meter
from study.workflow.store import Store, Task

STAGES = ("collect", "record_data", "ensemble", "tune", "train", "validate", "evaluate", "record")


class Stage(Protocol):
    """A stage's module: `run` is a pure function from files to files.

    A stage with ``RESUMABLE = True`` finds in `out` what a stopped run of the same task left there.
    """

    @staticmethod
    def run(
        settings: dict[str, Any], inputs: dict[str, Path], out: Path, progress: Progress
    ) -> None:
        """Read the folders `inputs`, write into the folder `out`."""
        ...


@dataclass(frozen=True)
class Outcome:
    """How a task ended. `error` is one line; the log has the rest."""

    task: Task
    seconds: float
    error: str | None = None


def execute(task: Task, root: Path, threads: int) -> Outcome:
    """Run the task and complete its folder. An exception of the stage becomes an `Outcome`."""
    store = Store(root)
    began, meter = datetime.now(UTC), Meter()
    log = store.log(task)
    log.parent.mkdir(parents=True, exist_ok=True)
    progress = Progress(store.progress(task))
    error = None
    with _logged(log):
        try:
            prepare(task.plugins, threads)
            out = store.begin(task, getattr(_stage(task), "RESUMABLE", False))
            inputs = {name: store.folder(source) for name, source in task.inputs.items()}
            progress(0.0, "started")
            run_stage(task, inputs, out, progress)
            began_at = began.isoformat(timespec="milliseconds")
            store.finish(task, {"began": began_at, "threads": threads} | meter.read())
        except Exception as problem:
            traceback.print_exc()
            error = f"{type(problem).__name__}: {' '.join(str(problem).split())}"[:300]
        finally:
            store.progress(task).unlink(missing_ok=True)
    return Outcome(task, meter.read()["seconds"], error)


def run_stage(task: Task, inputs: Mapping[str, Path], out: Path, progress: Progress) -> None:
    """Run the task's stage on the folders `inputs`, into the folder `out`; see `prepare`."""
    _stage(task).run(dict(task.settings), dict(inputs), out, progress)


def _stage(task: Task) -> Any:
    return importlib.import_module(f"study.stages.{task.stage}")


def prepare(plugins: tuple[str, ...], threads: int) -> None:
    """The same beginning for every task, whichever tasks this process ran before it."""
    import torch

    for plugin in plugins:
        importlib.import_module(plugin)
    torch.set_num_threads(threads)
    torch.use_deterministic_algorithms(True, warn_only=True)
    # Memory that is about to be written need not be filled with NaN before.
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002 - Optuna and Lightning may still look there
    torch.manual_seed(0)


@contextmanager
def _logged(path: Path) -> Iterator[None]:
    """Everything that the task prints or logs goes to its own file."""
    with path.open("w", buffering=1, encoding="utf-8") as file:
        handler = logging.StreamHandler(file)
        handler.setFormatter(logging.Formatter("%(asctime)s %(name)s: %(message)s"))
        loggers = [logging.getLogger(name) for name in ("", "lightning", "lightning.pytorch")]
        quiet = [(logger, logger.handlers[:], logger.propagate) for logger in loggers]
        for logger in loggers:
            logger.handlers = [handler] if logger.name == "root" else []
            logger.propagate = True
        try:
            with redirect_stdout(file), redirect_stderr(file), warnings.catch_warnings():
                yield
        finally:
            for logger, handlers, propagate in quiet:
                logger.handlers, logger.propagate = handlers, propagate
