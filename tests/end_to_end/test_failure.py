"""A stage that fails, a worker that dies, a full disk: one line each, and the rest goes on."""

import errno
import os
from pathlib import Path
from typing import Any

import pytest

from study.workflow.lock import locked
from study.workflow.store import Store
from tests.helpers.running import SMALL, Done, results, run, study

BOTH = [*SMALL, "--grid.environments", "[cart, quicksand]"]


def _full(*_: Any, **__: Any) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _check_the_others_finished(done: Done, out: Path, error: str) -> None:
    assert done.code == 1
    rows = [line.split() for line in done.out.splitlines()]
    assert all(row[1:2] == ["failed"] for row in rows if row and row[0].startswith("quicksand/"))
    assert any(row and row[0] == "cart/low/full_vae/seed-0" and len(row) > 3 for row in rows)
    lines = [line for line in done.out.splitlines() if line.startswith("FAILED collect quicksand")]
    assert len(lines) == 1
    assert error in lines[0]
    assert "FAILED record quicksand/low/oracle/seed-0: not run: " in done.out
    assert (out / "weights/cart/low/full_vae/seed-0.safetensors").exists()
    assert not (out / "weights/quicksand").exists()


def test_a_stage_that_raises(copied: Path, small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("QUICKSAND", "raise")
    done = study("all", *BOTH, "--out", copied)
    _check_the_others_finished(done, copied, "FloatingPointError: the cart sank")
    log = Path(done.out.split("its log: ")[1].splitlines()[0])
    assert "in rollout" in log.read_text()
    status = study("status", *BOTH, "--out", copied).out
    assert "Quicksand.rollout raised FloatingPointError: the cart sank" in status
    monkeypatch.delenv("QUICKSAND")
    done = study("all", *BOTH, "--out", copied)
    assert done.code == 0
    assert "\n[14/14] " in done.out
    weights = "weights/cart/low/full_vae/seed-0.safetensors"
    assert results(copied)[weights] == results(small)[weights]


def test_a_worker_that_dies_and_two_workers_give_the_same_bytes(
    tmp_path: Path, small: Path
) -> None:
    dask = ["--engine.kind", "dask", "--engine.workers", "2", "--engine.retries", "1"]
    done = run("all", *BOTH, *dask, "--out", tmp_path, QUICKSAND="exit")
    _check_the_others_finished(done, tmp_path, "the worker was lost 2 times")
    assert done.out.count("collect quicksand: the worker was lost (") == 1
    assert done.err == ""
    repeated = study("all", *SMALL, "--out", tmp_path)
    assert repeated.out.startswith(f"{tmp_path}: no stage to run, results written again\n")
    assert results(tmp_path) == results(small)


def test_one_worker_gives_the_same_bytes(tmp_path: Path, small: Path) -> None:
    done = run("all", *SMALL, "--engine.kind=dask", "--engine.workers=1", "--out", tmp_path)
    assert done.code == 0
    assert done.err == ""
    assert results(tmp_path) == results(small)


def test_every_cell_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("QUICKSAND", "raise")
    done = study("all", *SMALL, "--grid.environments=[quicksand]", "--out", tmp_path)
    assert done.code == 1
    assert done.err == ""
    assert not results(tmp_path)


def test_a_disk_that_is_full_while_a_stage_runs(
    copied: Path, small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    changed = [*SMALL, "--evaluate.examples", "1", "--out", copied]
    with monkeypatch.context() as context:
        context.setattr("study.stages.evaluate.save_arrays", _full)
        done = study("all", *changed)
    assert done.code == 1
    assert "OSError: [Errno 28] No space left on device" in done.out
    assert study("all", *changed).code == 0
    assert study("all", *SMALL, "--out", copied).code == 0
    assert results(copied) == results(small)


def test_a_disk_that_is_full_while_results_are_written(
    copied: Path, small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (copied / "claims.json").unlink()
    with monkeypatch.context() as context:
        context.setattr("study.results.summary.write_text", _full)
        done = study("all", *SMALL, "--out", copied)
    assert done.code == 1
    assert done.err.count("\n") == 1
    assert done.err.startswith("error: the disk is full; ")
    done = study("all", *SMALL, "--out", copied)
    assert "no stage to run, results written again" in done.out
    assert results(copied) == results(small)


def test_two_runs_on_one_folder(copied: Path) -> None:
    with locked(copied):
        before = results(copied)
        done = study("all", *SMALL, "--out", copied, "--tune.trials", "1")
        assert done.code == 2
        assert f"{copied} is in use by process {os.getpid()}" in done.err
        assert done.err.count("\n") == 1
        shown = study("status", *SMALL, "--out", copied).out
        assert "(a run is going on)" in " ".join(shown.split())  # a long title has two lines
    assert results(copied) == before


@pytest.mark.parametrize("command", [["status"], ["figures"], ["view", "cart/low/drift/seed-0"]])
def test_a_missing_folder(command: list[str], tmp_path: Path) -> None:
    out = tmp_path / "nowhere"
    done = study(*command, *SMALL, "--out", out)
    assert done.code in (1, 2)
    assert done.out == ""
    assert str(out) in done.err
    assert done.err.count("\n") == 1
    assert not out.exists()


def test_a_damaged_recording_is_not_opened(copied: Path) -> None:
    cell = "cart/low/drift/seed-0"
    path = copied / "recordings" / cell / "scores.rrd"
    path.write_bytes(path.read_bytes()[:-1])
    done = study("view", cell, *SMALL, "--kind", "scores", "--out", copied)
    assert done.code == 1
    assert f"recording {path} is damaged" in done.err


def test_what_a_stage_prints_goes_to_its_log(copied: Path) -> None:
    logs = {path.name.partition("-")[0] for path in Store(copied / "work").root.glob("logs/*.log")}
    stages = {"collect", "record_data", "ensemble", "tune", "train", "evaluate", "record"}
    assert logs == stages
