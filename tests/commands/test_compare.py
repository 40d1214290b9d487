"""Cells side by side, from recordings alone; and what `view` opens."""

import json
from pathlib import Path

import pytest

from study.commands.compare import compare
from study.common.errors import BadInput
from study.recording import viewer
from study.recording.properties import Properties
from study.recording.scores import record_scores
from study.run import main
from tests.helpers import recordings

FIRST, SECOND = "pusher/low/residual_vae/seed-0", "pusher/low/full_vae/seed-0"


@pytest.fixture
def out(tmp_path: Path) -> Path:
    for cell, beta, better in ((FIRST, 0.1, 1.0), (SECOND, 0.2, 2.0)):
        table = recordings.scores()
        table["value"] *= better
        config = {"trained": {"beta": beta, "steps": 100, "model": "any", "seed": cell}}
        model = cell.split("/")[2]
        properties: Properties = {
            "cell": cell,
            "model": model,
            "seed": 0,
            "config": json.dumps(config),
        }
        record_scores(tmp_path / "recordings" / cell / "scores.rrd", table, properties)
    return tmp_path


def test_settings_that_differ_and_scores(out: Path) -> None:
    paths = {cell: out / "recordings" / cell / "scores.rrd" for cell in (FIRST, SECOND)}
    differing, scores = compare(paths)
    assert list(differing.loc["model"]) == ["residual_vae", "full_vae"]
    assert list(differing.loc["trained.beta"]) == [0.1, 0.2]
    assert len(differing) == 2
    assert list(scores.loc["brier"]) == [0.171, 0.342]
    table = recordings.scores()
    mmd2 = table[(table.metric == "mmd2") & (table.dimension == "all") & (table.step == -1)].value
    assert scores.loc["mmd2", FIRST] == mmd2.item()


def test_a_cell_with_itself_is_refused(out: Path) -> None:
    with pytest.raises(BadInput, match="two cells"):
        compare({FIRST: out / "recordings" / FIRST / "scores.rrd"})


def test_the_command_prints_both(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", FIRST, SECOND, "--out", str(out)]) == 0
    text = capsys.readouterr().out
    for expected in (FIRST, SECOND, "trained.beta", "brier", "0.171", "0.342"):
        assert expected in text


@pytest.mark.parametrize("damage", ["missing", "flipped", "empty"])
def test_a_bad_recording_is_one_line(
    out: Path, damage: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = out / "recordings" / SECOND / "scores.rrd"
    content = bytearray(path.read_bytes())
    path.unlink()
    if damage != "missing":
        content[len(content) // 2] ^= 1
        path.write_bytes(content if damage == "flipped" else b"")
    assert main(["compare", FIRST, SECOND, "--out", str(out)]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert str(path) in error


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("study", "study.rrd"),
        ("pusher", "pusher/data.rrd"),
        (FIRST, f"{FIRST}/forecast.rrd"),
    ],
)
def test_view_opens_by_name(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    name: str,
    file: str,
) -> None:
    opened: list[Path] = []
    monkeypatch.setattr(viewer, "open_viewer", opened.extend)
    path = tmp_path / "recordings" / file
    assert main(["view", name, "--out", str(tmp_path)]) == 1
    assert f"there is no recording {path}" in capsys.readouterr().err
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    assert main(["view", name, "--out", str(tmp_path)]) == 0
    assert opened == [path]


def test_view_knows_the_cells_of_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A study of other seeds than the configuration's is opened by its folder alone."""
    opened: list[Path] = []
    monkeypatch.setattr(viewer, "open_viewer", opened.extend)
    name = "uav/low/full_vae/seed-7"
    path = tmp_path / "recordings" / name / "forecast.rrd"
    path.parent.mkdir(parents=True)
    path.touch()
    assert main(["view", name, "--out", str(tmp_path)]) == 2
    assert f"unknown cell '{name}'" in capsys.readouterr().err
    facts = {"format": 1, "settings": {"grid": {"seeds": [7]}}, "cells": [], "versions": {}}
    (tmp_path / "study.json").write_text(json.dumps(facts))
    assert main(["view", name, "--out", str(tmp_path)]) == 0
    assert opened == [path]


def test_saving_pictures_without_a_driver_is_one_line(
    out: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(viewer, "has_driver", lambda: False)
    arguments = ["view", FIRST, "--kind", "scores", "--out", str(out)]
    assert main([*arguments, "--save", str(out / "pictures")]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: no Vulkan driver")
    assert error.count("\n") == 1
    file = out / "file"
    file.touch()
    assert main([*arguments, "--save", str(file)]) == 2
    assert "is no folder" in capsys.readouterr().err
