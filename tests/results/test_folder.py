"""Reading a results folder."""

import json
from pathlib import Path

import pytest

from study.common.errors import BadInput, StudyError
from study.config.settings import Config
from study.results import folder
from tests.helpers.running import ROOT

CELL = "uav/low/full_vae/seed-0"


def write(out: Path, **facts: object) -> None:
    """A ``study.json`` with some of its facts changed."""
    complete = {
        "format": folder.FORMAT,
        "settings": folder.settings_of(Config()),
        "cells": [CELL],
        "versions": {"python": "3.11"},
    }
    (out / folder.STUDY).write_text(json.dumps(complete | facts))


def test_it_gives_the_settings_and_cells(tmp_path: Path) -> None:
    write(tmp_path)
    results = folder.read(tmp_path)
    assert results.config == Config()
    assert [cell.name for cell in results.complete] == [CELL]
    cell = results.cell(CELL, "--cell")
    assert results.has_weights(cell)
    assert results.weights(cell) == tmp_path / "weights" / f"{CELL}.safetensors"


def test_an_unknown_cell_names_the_flag_and_the_nearest(tmp_path: Path) -> None:
    write(tmp_path)
    with pytest.raises(BadInput, match=f"^--cell: .* did you mean '{CELL}'"):
        folder.read(tmp_path).cell("uav/low/full_va/seed-0", "--cell")


@pytest.mark.parametrize(
    ("facts", "expected"),
    [
        ({"format": 0}, r"another version of the study \(its format is 0, this version has 1\)"),
        ({"settings": {"nam": "x"}}, "another version of the study: unknown setting 'nam'"),
        ({"settings": {"tune": {"trails": 1}}}, "unknown setting 'tune.trails'"),
    ],
)
def test_another_version(tmp_path: Path, facts: dict[str, object], expected: str) -> None:
    write(tmp_path, **facts)
    with pytest.raises(BadInput, match=expected):
        folder.read(tmp_path)


@pytest.mark.parametrize("facts", [{"cells": ["uav/low"]}, {"versions": 3}, {"settings": 7}])
def test_damage(tmp_path: Path, facts: dict[str, object]) -> None:
    write(tmp_path, **facts)
    with pytest.raises(StudyError, match="is damaged"):
        folder.read(tmp_path)


def test_the_studies_beside_it_are_named(tmp_path: Path) -> None:
    (tmp_path / "quick").mkdir()
    write(tmp_path / "quick")
    with pytest.raises(BadInput, match=f"did you mean '{tmp_path / 'quick'}'"):
        folder.read(tmp_path / "quik")


def test_the_committed_results_are_read() -> None:
    """Settings may have been added after they were published."""
    assert folder.read(ROOT / "results" / "paper").config.name == "paper"
