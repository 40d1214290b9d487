"""Studies that several tests read. A test that changes one takes a copy."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers.running import SMALL, SMOKE, Done, run, study

STUDIES = {"smoke", "small"}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that need a study as slow, since any of them may be the one that runs it."""
    for item in items:
        if STUDIES & set(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def smoke(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Done]:
    """The smoke study, as a user runs it."""
    out = tmp_path_factory.mktemp("smoke") / "results"
    return out, run("all", *SMOKE, "--out", out)


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of the tutorial's environment and model, run in this process without interruption."""
    out = tmp_path_factory.mktemp("small") / "results"
    done = study("all", *SMALL, "--out", out)
    assert done.code == 0, done
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
