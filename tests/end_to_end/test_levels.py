"""A study with a level of its own, and with a model that has a setting of its own."""

import shutil
from pathlib import Path

import pandas as pd
import pytest

from study.common.files import read_json, write_json
from study.config.grid import cells
from study.workflow.pipeline import Pipeline
from tests.helpers.running import SMALL, Done, configuration, study

LEVELS = {"low": 1.0, "high": 0.25, "tiny": 0.05}
FLAGS = [
    *SMALL,
    "--grid.levels={low: 1.0, high: 0.25, tiny: 0.05}",
    "--grid.models=[drift]",
    "--grid.seeds=[0, 1]",
    "--model.drift.initial_std=0.2",
]

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Done]:
    """The study."""
    out = tmp_path_factory.mktemp("three") / "results"
    return out, study("all", *FLAGS, "--out", out)


def test_every_level_is_scored_and_shown(three: tuple[Path, Done]) -> None:
    out, done = three
    assert done.code == 0, done
    scores = pd.read_parquet(out / "scores.parquet")
    assert set(scores.level) == set(LEVELS)
    assert len(set(scores[scores.model == "drift"][["level", "seed"]].itertuples(index=False))) == 6
    for table in (out / "tables").glob("*_cart.md"):
        assert "tiny" in table.read_text(encoding="utf-8").lower()
    assert {path.stem for path in (out / "figures").glob("*.png")} >= {"mmd_cart", "variance_cart"}
    assert study("verify", out).code == 0


def test_a_level_trains_on_its_fraction() -> None:
    config = configuration(*FLAGS)
    assert config.grid.levels == LEVELS
    pipeline = Pipeline(config)
    parts = {
        (cell.level, cell.seed): pipeline.train(cell).settings["training"]
        for cell in cells(config)
        if not cell.is_reference
    }
    assert parts["low", 0] == parts["low", 1] == {"first": 0, "trajectories": 40, "of": None}
    assert parts["high", 1] == {"first": 10, "trajectories": 10, "of": None}
    assert parts["tiny", 1] == {"first": 2, "trajectories": 2, "of": None}


def test_the_models_own_setting_is_stored_and_read(three: tuple[Path, Done]) -> None:
    out, _ = three
    assert read_json(out / "study.json")["settings"]["model"] == {"drift": {"initial_std": 0.2}}
    assert "0 of" in study("plan", *FLAGS, "--out", out).out
    changed = study("plan", *FLAGS, "--model.drift.initial_std=0.3", "--out", out).due()
    trained = [name for name in changed if name.startswith("train ")]
    assert len(trained) == 6
    assert all("initial_std" in changed[name] for name in trained)
    assert not any(name.startswith(("collect", "ensemble")) for name in changed)


def test_a_study_whose_plugin_is_missing(three: tuple[Path, Done], tmp_path: Path) -> None:
    copied = Path(shutil.copytree(three[0], tmp_path / "copied"))
    facts = read_json(copied / "study.json")
    facts["settings"]["plugins"] = ["nowhere"]
    write_json(copied / "study.json", facts)
    done = study("verify", copied)
    assert done.code == 2
    reason = "cannot import 'nowhere': No module named 'nowhere'"
    assert done.err == f"error: {copied}: plugins: {reason}\n"
