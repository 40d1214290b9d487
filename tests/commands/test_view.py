"""Which recording `view` opens, and its errors."""

import json
from pathlib import Path

import pytest

from study.recording import viewer
from study.recording.scores import record_scores
from study.results import folder
from study.run import main
from tests.helpers import recordings
from tests.helpers.running import configuration

CELL = "pusher/low/residual_vae/seed-0"


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The recordings that the viewer was asked to open."""
    paths: list[Path] = []
    monkeypatch.setattr(viewer, "open_viewer", paths.extend)
    return paths


def put(out: Path, name: str) -> Path:
    """An empty file in place of a recording."""
    path = out / "recordings" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    return path


@pytest.mark.parametrize(
    ("name", "file"),
    [("study", "study.rrd"), ("pusher", "pusher/data.rrd"), (CELL, f"{CELL}/forecast.rrd")],
)
def test_it_opens_by_name(
    tmp_path: Path,
    opened: list[Path],
    capsys: pytest.CaptureFixture[str],
    name: str,
    file: str,
) -> None:
    assert main(["view", name, "--out", str(tmp_path)]) == 1
    assert f"there is no recording {tmp_path / 'recordings' / file}" in capsys.readouterr().err
    path = put(tmp_path, file)
    assert main(["view", name, "--out", str(tmp_path)]) == 0
    assert opened == [path]


def test_it_names_the_kinds_that_exist(
    tmp_path: Path, opened: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    put(tmp_path, f"{CELL}/scores.rrd")
    put(tmp_path, f"{CELL}/tuning.rrd")
    assert main(["view", CELL, "--out", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert "give --kind: scores, tuning; or run " in error
    assert f"forecast --cell {CELL} --scenario 0" in error
    assert error.count("\n") == 1


def test_it_knows_the_cells_of_the_folder(
    tmp_path: Path, opened: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """A study with other seeds than the settings is opened by its folder alone."""
    name = "uav/low/full_vae/seed-7"
    path = put(tmp_path, f"{name}/forecast.rrd")
    assert main(["view", name, "--out", str(tmp_path)]) == 2
    assert f"unknown cell '{name}'" in capsys.readouterr().err
    facts = {
        "format": folder.FORMAT,
        "settings": folder.settings_of(configuration("--grid.seeds=[7]")),
        "cells": [],
        "versions": {},
    }
    (tmp_path / "study.json").write_text(json.dumps(facts))
    assert main(["view", name, "--out", str(tmp_path)]) == 0
    assert opened == [path]


def test_pictures_without_a_driver_are_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "recordings" / CELL / "scores.rrd"
    record_scores(path, recordings.scores(), {"cell": CELL})
    monkeypatch.setattr(viewer, "has_driver", lambda: False)
    arguments = ["view", CELL, "--kind", "scores", "--out", str(tmp_path)]
    assert main([*arguments, "--save", str(tmp_path / "pictures")]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert "Vulkan driver" in error
    assert error.count("\n") == 1


def test_pictures_need_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "recordings" / CELL / "scores.rrd"
    record_scores(path, recordings.scores(), {"cell": CELL})
    file = tmp_path / "file"
    file.touch()
    arguments = ["view", CELL, "--kind", "scores", "--out", str(tmp_path), "--save", str(file)]
    assert main(arguments) == 2
    assert f"--save: '{file}' is not a folder" in capsys.readouterr().err
