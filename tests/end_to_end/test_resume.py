"""A study that is killed at any moment and started again leaves the same bytes."""

import json
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from study.recording.integrity import check
from tests.helpers.running import SMALL, files, results, run, start, study

PROCESSES = Path("/proc")


def _entries(out: Path) -> list[dict[str, Any]]:
    """The entries of the Optuna journal of a search that is not complete."""
    journals = list(out.glob("work/tune/.*.partial/journal.log"))
    lines = journals[0].read_text().splitlines() if journals else []
    return [json.loads(line) for line in lines if line.endswith("}")]


def _ended_trials(out: Path) -> int:
    return sum(entry.get("op_code") == 6 and entry["state"] in (1, 2) for entry in _entries(out))


def _tuning(out: Path) -> bool:
    return 1 <= _ended_trials(out) <= 3


def _training(out: Path) -> bool:
    return any(out.glob("work/train/.*.partial/*"))


def _evaluating(out: Path) -> bool:
    return any(out.glob("work/evaluate/.*.partial"))


def _publishing(out: Path) -> bool:
    return (out / "scores.parquet").exists() and not (out / "work/summary.json").exists()


def _kill_when(reached: Callable[[Path], bool], out: Path, *extra: str) -> None:
    """Start the study, and kill its main process when a state is reached."""
    process = start("all", *SMALL, *extra, "--out", out)
    try:
        while not reached(out):
            assert process.poll() is None, "it ended before it was killed"
            time.sleep(0.001)
    finally:
        process.kill()
        process.communicate()


def test_killed_at_several_moments(tmp_path: Path, small: Path) -> None:
    out = tmp_path / "results"
    for reached in (_tuning, _evaluating, _publishing):
        _kill_when(reached, out)
        assert reached(out), "it was killed too late"
    done = study("all", *SMALL, "--out", out)
    assert done.code == 0
    assert results(out) == results(small)
    names = set(files(out)) - {name for name in files(out) if name.startswith("work/")}
    assert names == {name for name in files(small) if not name.startswith("work/")}
    for path in (out / "recordings").rglob("*.rrd"):
        check(path)
    # No partial file is left, and nothing ran twice.
    assert not list(out.glob("work/*/.*"))
    assert study("all", *SMALL, "--out", out).out.startswith(f"{out}: everything is up to date")


def test_a_search_resumes_where_it_stopped(tmp_path: Path, small: Path) -> None:
    _kill_when(_tuning, tmp_path)
    begun = _entries(tmp_path)
    assert run("all", *SMALL, "--out", tmp_path).code == 0
    (journal,) = tmp_path.glob("work/tune/*/journal.log")
    entries = [json.loads(line) for line in journal.read_text().splitlines()]
    assert entries[: len(begun)] == begun
    (tuned,) = tmp_path.glob("work/tune/*/tuning.json")
    (uninterrupted,) = small.glob("work/tune/*/tuning.json")
    assert tuned.read_bytes() == uninterrupted.read_bytes()
    assert results(tmp_path) == results(small)


@pytest.mark.slow
@pytest.mark.skipif(not PROCESSES.is_dir(), reason="the system has no /proc")
def test_workers_end_with_the_run(tmp_path: Path) -> None:
    _kill_when(_training, tmp_path, "--engine.kind=dask", "--engine.workers=2")
    deadline = time.monotonic() + 60
    while left := _processes_of(tmp_path):
        assert time.monotonic() < deadline, f"still running: {left}"
        time.sleep(0.1)
    done = study("all", *SMALL, "--out", tmp_path)
    assert done.code == 0


def test_interrupted(tmp_path: Path, small: Path) -> None:
    """Ctrl-C reaches every process of the terminal's group."""
    process = start(
        "all",
        *SMALL,
        "--engine.kind=dask",
        "--engine.workers=2",
        "--out",
        tmp_path,
    )
    while not _training(tmp_path):
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate()
    assert process.returncode == 130
    assert err == "stopped: run the same command again to go on from here\n"
    assert not _processes_of(tmp_path)
    assert study("all", *SMALL, "--out", tmp_path).code == 0
    assert results(tmp_path) == results(small)


def _processes_of(out: Path) -> list[str]:
    """The processes that were started for this study."""
    wanted, found = f"STUDY_OF={out}".encode(), []
    for path in PROCESSES.glob("[0-9]*/environ"):
        try:
            if wanted in path.read_bytes().split(b"\0"):
                found.append(path.parent.name)
        except OSError:
            continue  # it has ended, or belongs to another user
    return found


@pytest.fixture(autouse=True)
def _mark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A mark that every process that a test starts inherits."""
    monkeypatch.setenv("STUDY_OF", str(tmp_path))
