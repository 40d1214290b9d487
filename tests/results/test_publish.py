"""What publishing removes: files of cells that left the grid, and nothing that is lost for good."""

import shutil
from pathlib import Path

import pytest

from tests.helpers.running import SMALL, files, published, study


def test_no_empty_folder_is_left(copied: Path) -> None:
    assert study("all", *SMALL, "--out", copied, "--grid.models", "[drift]").code == 0
    assert not list(copied.glob("*/cart/low/full_vae"))
    folders = [path for path in copied.rglob("*") if path.is_dir()]
    assert [path for path in folders if not any(path.iterdir())] == []


def test_a_part_of_a_shipped_study_is_refused_and_said_beforehand(copied: Path) -> None:
    shutil.rmtree(copied / "work")
    before = files(copied)
    part = [*SMALL, "--only", "*/oracle/*", "--out", copied]
    lost = "cart/low/drift/seed-0, cart/low/ensemble/seed-0, cart/low/full_vae/seed-0 would be lost"
    assert lost in study("plan", *part).out.splitlines()[-1]
    done = study("all", *part)
    assert (done.code, done.out) == (2, "")
    assert lost in done.err
    assert files(copied) == before
    assert study("all", *SMALL, "--out", copied).code == 0


def test_a_stage_that_fails_does_not_cost_shipped_results(
    copied: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.rmtree(copied / "work")
    before = published(copied)
    monkeypatch.setattr("study.stages.train.save_model", None)
    done = study("all", *SMALL, "--out", copied)
    assert done.code == 1
    assert "results are not published: the results of cart/low/drift/seed-0, " in done.out
    assert published(copied) == before
    rows = [line for line in done.out.splitlines() if line.startswith("FAILED")]
    assert any("not run: " in row and "log" not in row for row in rows)
    assert all(Path(row.split("log: ")[1]).is_file() for row in rows if "log: " in row)
