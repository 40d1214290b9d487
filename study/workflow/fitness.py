"""Whether a worker of a cluster can run stages of a study: its source, packages and folder.

`why_unfit` runs on the worker, before the worker imports other modules of the study. The source is
read once in the life of a worker. So a worker that has imported the study before an edit is told
from one that has the new source.

A worker is brought into the state of `study.common.isolation`, as the main process is. The threads
of NumPy are fixed when NumPy is imported, which Dask does. So the worker must have been started
with one thread for them; a nanny of Dask does this by default.
"""

import os
import socket
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from secrets import token_hex

from study.common.errors import BadInput, explain
from study.common.files import write_text
from study.common.isolation import isolate
from study.common.provenance import source_revision, versions
from study.workflow.source import source_digests
from study.workflow.task import Task

SHARED = ".cluster"
"""The file in the folder of the store by which a worker finds that it sees the same folder."""
HAD_NUMPY = "numpy" in sys.modules
NUMPY_THREADS = os.environ.get("OPENBLAS_NUM_THREADS", os.environ.get("OMP_NUM_THREADS"))
"""Threads of NumPy in this process, before `isolate` removes the variables."""


class UnfitWorker(Exception):
    """A worker cannot run stages of this study."""


@dataclass(frozen=True)
class Expected:
    """What a worker must have in common with the main process.

    Attributes:
        packages: versions of Python and of packages.
        source: hash of the source of the study.
        plugins: digest of every module of the plugins.
        plugin_modules: the plugins.
        root: folder of the store.
        token: the content of the file `SHARED` in this folder.
    """

    packages: Mapping[str, str]
    source: str
    plugins: Mapping[str, str]
    plugin_modules: tuple[str, ...]
    root: Path
    token: str

    @classmethod
    def here(cls, root: Path, plugins: tuple[str, ...], token: str) -> "Expected":
        """What this process has."""
        digests = source_digests(plugins)
        return cls(packages(), source_revision(), digests, plugins, root, token)


@contextmanager
def shared(root: Path, tasks: Iterable[Task]) -> Iterator[Expected]:
    """What workers must have in common with this process, with the file `SHARED` in place.

    Args:
        root: folder of the store.
        tasks: those of the run.
    """
    plugins = tuple(dict.fromkeys(name for task in tasks for name in task.plugins))
    expected = Expected.here(root, plugins, token_hex(8))
    try:
        write_text(root / SHARED, expected.token)
        yield expected
    finally:
        (root / SHARED).unlink(missing_ok=True)


def packages() -> dict[str, str]:
    """The versions on which numbers, or the exchange with workers, depend."""
    return versions() | {"distributed": version("distributed")}


def why_unfit(expected: Expected, tasks: int) -> str | None:
    """Why this process, a worker, cannot run stages; None if it can.

    Args:
        expected: what it must have in common with the main process.
        tasks: that the worker runs at a time.
    """
    try:
        isolate()
    except BadInput as error:
        return str(error)
    if tasks != 1:
        return f"it runs {tasks} tasks in one process; start it with --nthreads 1"
    if HAD_NUMPY and NUMPY_THREADS != "1":
        return "NumPy uses several threads there; start it with OMP_NUM_THREADS=1"
    return _why_other_version(expected) or _why_other_folder(expected.root, expected.token)


def _why_other_version(expected: Expected) -> str | None:
    found = packages()
    for name, wanted in expected.packages.items():
        if found.get(name) != wanted:
            return f"it has {name} {found.get(name)}, and this process {wanted}; install {wanted}"
    if _source() != expected.source:
        return (
            f"it has another version of the study (source {_source()[:8]}, here "
            f"{expected.source[:8]}); install this version there, and start the worker again"
        )
    if source_digests(expected.plugin_modules) != expected.plugins:
        return f"its plugins {', '.join(expected.plugin_modules)} differ; copy them, and restart it"
    return None


def _why_other_folder(root: Path, token: str) -> str | None:
    """Why this machine does not share the folder; it is tried, since permissions may mislead."""
    where = f"{root} on {socket.gethostname()}"
    try:
        if (root / SHARED).read_text(encoding="utf-8") != token:
            return f"{where} is another folder; mount the shared one under the same path"
        trial = root / f"{SHARED}.{socket.gethostname()}.{os.getpid()}"
        trial.touch()
        trial.unlink()
    except FileNotFoundError:
        return f"it does not see {where}; mount the folder there, or give another --out"
    except OSError as error:
        return f"it cannot use the folder: {explain(error)}"
    return None


@cache
def _source() -> str:
    """The source of the study when this process was first asked."""
    return source_revision()
