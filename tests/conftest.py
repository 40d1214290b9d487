"""Studies that several tests read. A test that changes one takes a copy."""

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import pytest
from filelock import FileLock

from tests.helpers.running import SMALL, SMOKE, Done, run, study

STUDIES = {"smoke", "small"}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that need a study as slow, since any of them may be the one that runs it."""
    for item in items:
        if STUDIES & set(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Path:
    """A folder that all processes of a test run share."""
    base = tmp_path_factory.getbasetemp()
    return base if worker_id == "master" else base.parent


@pytest.fixture(scope="session")
def smoke(shared: Path) -> tuple[Path, Done]:
    """The smoke study, as a user runs it. The first test process that needs it runs it."""
    out, record = shared / "smoke" / "results", shared / "smoke.json"
    with FileLock(shared / "smoke.lock"):
        if not record.exists():
            record.write_text(json.dumps(asdict(run("all", *SMOKE, "--out", out))))
    return out, Done(**json.loads(record.read_text()))


@pytest.fixture(scope="session")
def small(shared: Path) -> Path:
    """A study of the tutorial's environment and model, run in this process without interruption.

    The first test process that needs it runs it.
    """
    out, complete = shared / "small" / "results", shared / "small.complete"
    with FileLock(shared / "small.lock"):
        if not complete.exists():
            done = study("all", *SMALL, "--out", out)
            assert done.code == 0, done
            complete.touch()
    return out


@pytest.fixture
def copied(small: Path, tmp_path: Path) -> Path:
    """A copy of the small study, to be changed or damaged."""
    return Path(shutil.copytree(small, tmp_path / "copied"))


@pytest.fixture
def only(copied: Path) -> Callable[[str], Path]:
    """The one file of the copied study that matches a pattern."""

    def find(pattern: str) -> Path:
        (path,) = copied.glob(pattern)
        return path

    return find
