"""Which runs would destroy results that cannot be made again."""

from dataclasses import replace
from pathlib import Path

import pytest

from study.commands.settings import change
from study.common.files import read_json, write_json
from study.config.grid import Cell, cells
from study.config.settings import Config
from study.results.folder import FORMAT, settings_of
from study.results.protection import why_refused
from study.workflow.store import Store
from tests.helpers.running import configuration

CONFIG = configuration()
EVERY = cells(CONFIG)
ONE = EVERY[0]


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A results folder of all cells, without ``work/``."""
    facts = {"format": FORMAT, "settings": settings_of(CONFIG), "cells": [c.name for c in EVERY]}
    write_json(tmp_path / "study.json", facts)
    for cell in EVERY:
        path = tmp_path / "weights" / f"{cell.name}.safetensors"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return tmp_path


def refused(out: Path, config: Config = CONFIG, made: list[Cell] = EVERY) -> str | None:
    return why_refused(config, made, Store(out / "work"), out)


def evaluated(out: Path, label: str) -> None:
    write_json(
        out / "work" / "evaluate" / label.replace("/", "-") / "manifest.json", {"label": label}
    )


def test_all_cells_again_with_the_same_settings(out: Path) -> None:
    assert refused(out) is None
    for changes in (["--name=other"], ["--publish.weights=[pusher]"], ["--engine.threads=2"]):
        assert refused(out, change(CONFIG, changes)) is None


def test_some_of_the_cells(out: Path) -> None:
    text = refused(out, made=[ONE])
    assert text is not None
    assert f"and {len(EVERY) - 7} more would be lost" in text


def test_the_others_are_named(out: Path) -> None:
    text = refused(out, made=EVERY[1:])
    assert text == f"the results of {ONE.name} would be lost, since {out} has no work/ of them"


def test_other_settings(out: Path) -> None:
    text = refused(out, change(CONFIG, ["--train.steps=7"]))
    assert text is not None
    assert text.endswith("(settings differ: train.steps)")
    text = refused(out, change(CONFIG, ["--grid.levels={low: 0.5, high: 0.1}"]))
    assert text is not None
    assert text.endswith("(settings differ: grid.levels.low)")


def test_a_setting_that_was_added_later_may_be_missing_at_its_default(out: Path) -> None:
    facts = read_json(out / "study.json")
    assert "precision" not in facts["settings"]["train"]
    facts["settings"]["train"]["precision"] = "32"
    write_json(out / "study.json", facts)
    assert refused(out) is None
    text = refused(out, change(CONFIG, ["--train.precision=bf16"]))
    assert text is not None
    assert text.endswith("(settings differ: train.precision)")


def test_a_larger_grid_keeps_everything(out: Path) -> None:
    larger = change(
        CONFIG, ["--grid.seeds=[0, 1]", "--grid.levels={low: 1, high: 0.1, tiny: 0.02}"]
    )
    assert refused(out, larger, cells(larger)) is None
    smaller = replace(CONFIG, grid=replace(CONFIG.grid, environments=("uav",)))
    assert "pusher" in (refused(out, smaller, cells(smaller)) or "")


def test_what_work_has_can_be_made_again(out: Path) -> None:
    for cell in EVERY:
        oracle = f"{cell.environment}/oracle/seed-{cell.seed}"
        evaluated(out, oracle if cell.model == "oracle" else cell.name)
    assert refused(out, made=[]) is None
    assert refused(out, change(CONFIG, ["--train.steps=7"]), [ONE]) is None


def test_the_oracle_of_earlier_versions_had_one_label(out: Path) -> None:
    for cell in EVERY:
        evaluated(out, f"{cell.environment}/oracle" if cell.model == "oracle" else cell.name)
    assert refused(out, change(CONFIG, ["--train.steps=7"]), [ONE]) is None


def test_files_of_a_study_whose_settings_are_lost(out: Path) -> None:
    (out / "study.json").write_text("{")
    text = refused(out)
    assert text is not None
    assert text.endswith("(settings differ: all, since study.json cannot be read)")
    assert f"{len(EVERY) - 6} more" in text


def test_a_new_folder(tmp_path: Path) -> None:
    assert refused(tmp_path, made=[ONE]) is None
