"""From logs to a scored study by the command line: inspect, all, verify, view data, forecast."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from study.common.files import read_json
from study.config import strict_yaml
from study.data.trajectories import ScenarioSet, Trajectories
from tests.helpers.logs import log
from tests.helpers.running import Done, study

SMALL = [
    "--grid.models=[full_crps, probabilistic_mlp]",
    "--engine.kind=serial",
    "--ensemble.members=2",
    "--ensemble.hidden_size=8",
    "--ensemble.steps=4",
    "--ensemble.validate_every=2",
    "--crps.hidden_size=8",
    "--crps.steps=6",
    "--mlp.hidden_size=16",
    "--mlp.layers=1",
    "--train.steps=6",
    "--train.validate_every=3",
    "--evaluate.samples=6",
    "--evaluate.examples=2",
]
YAML = """
name: bot
grid: {environments: [bot], levels: [low, high]}
bot:
  files: ["logs/*.csv"]
  state: ["x [m]", "v [m/s]"]
  action: [u]
  time: t
  horizon: 8
  stride: 2
  outcomes: ["moves = x > 0.2 at any step", "backwards = v < 0 at the end"]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with twenty logs and a configuration."""
    folder = tmp_path_factory.mktemp("robot")
    (folder / "logs").mkdir()
    for seed in range(20):
        log(seed=seed).to_csv(folder / "logs" / f"{seed:02}.csv", index=False)
    (folder / "bot.yaml").write_text(YAML, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def done(folder: Path) -> Done:
    """The study of the logs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        return study("all", "--config=bot.yaml", *SMALL)


@pytest.fixture
def inside(folder: Path, done: Done, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder as the working folder, after the study has run."""
    monkeypatch.chdir(folder)
    return folder


pytestmark = pytest.mark.slow


def test_all_cells_are_scored(folder: Path, done: Done) -> None:
    assert done.code == 0, done
    assert "20 logs, 800 rows" in done.out
    scores = pd.read_parquet(folder / "results/bot/scores.parquet")
    models = {"full_crps", "probabilistic_mlp", "ensemble", "training_climatology", "persistence"}
    assert set(scores["model"]) == models | {"analogues"}
    metrics = set(scores["metric"])
    assert {"crps", "energy_score", "coverage_90", "pit_01", "brier", "mmd2"} <= metrics
    assert not metrics & {"variance_ratio", "aleatoric_ratio", "mmd2_shift_1"}
    assert np.isfinite(scores.loc[scores["metric"] == "crps", "value"]).all()
    with_density = scores[scores["metric"] == "log_score"]
    assert set(with_density["model"]) == {"probabilistic_mlp"}
    assert np.isfinite(with_density["value"]).all()


def test_the_tables_say_what_is_left_out(folder: Path, done: Done) -> None:
    tables = folder / "results/bot/tables"
    text = (tables / "scores_bot.md").read_text(encoding="utf-8")
    assert "observed once" in text
    assert "Oracle" not in text
    assert "Moves" in (tables / "outcomes_bot.md").read_text(encoding="utf-8")


def test_the_split_is_in_the_facts_and_levels_are_fractions_of_trajectories(
    folder: Path, done: Done
) -> None:
    (data,) = (folder / "results/bot/work/collect").rglob("train.safetensors")
    training = Trajectories.load(data)
    test = ScenarioSet.load(data.with_name("test.safetensors"))
    split = training.facts["split"]
    assert [len(split[side]) for side in ("train", "validation", "test")] == [14, 3, 3]
    assert len({name for side in split.values() for name in side}) == 20
    assert sum(split["train"].values()) == len(training)
    assert test.observed.shape[1] == 1
    assert set(training.facts["files"]) == {f"logs/{seed:02}.csv" for seed in range(20)}


def test_a_second_run_has_nothing_to_do_and_a_changed_log_runs_again(inside: Path) -> None:
    assert "nothing to run" in study("all", "--config=bot.yaml", *SMALL).out
    outcome = '--bot.outcomes=["moves = x > 0.3 at any step"]'
    due = study("plan", "--config=bot.yaml", *SMALL, outcome).due()
    assert "train bot/low/full_crps/seed-0" not in due
    assert "evaluate bot/low/full_crps/seed-0" in due
    path = inside / "logs" / "00.csv"
    content = path.read_bytes()
    try:
        path.write_bytes(content.replace(b"\n0.1,", b"\n0.10,"))
        assert "collect bot" in study("plan", "--config=bot.yaml", *SMALL).due()
    finally:
        path.write_bytes(content)


def test_the_results_verify(inside: Path) -> None:
    done = study("verify", "results/bot", "--rerun=bot/low/full_crps/seed-0")
    assert done.code == 0, done


def test_a_forecast_of_a_window_and_of_a_plan(inside: Path) -> None:
    cell = ["--out=results/bot", "--cell=bot/low/full_crps/seed-0"]
    done = study("forecast", *cell, "--scenario=1", "--save=window.rrd")
    assert done.code == 0, done
    assert "6 forecasts and 1 observed" in done.out
    assert study("forecast", *cell, "--scenario=1", "--write=plan.csv").code == 0
    (inside / "logs").rename(inside / "away")
    try:
        done = study("forecast", *cell, "--file=plan.csv", "--save=plan.rrd")
        assert done.code == 0, done
        assert "never observed" in done.out
        done = study("forecast", *cell, "--file=plan.csv", "--scenario=-1", "--save=plan.rrd")
        assert (done.code, done.err.count("\n")) == (2, 1)
        assert "--scenario: got -1" in done.err
        done = study("forecast", *cell, "--scenario=1", "--save=window.rrd")
        assert done.code == 2
        assert "no file matches" in done.err
    finally:
        (inside / "away").rename(inside / "logs")


def test_nothing_is_written_for_bad_logs(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "logs").mkdir()
    for seed in range(6):
        log(seed=seed).to_csv(tmp_path / "logs" / f"{seed}.csv", index=False)
    broken = log(seed=7)
    broken.loc[3, "v"] = np.nan
    broken.to_csv(tmp_path / "logs" / "7.csv", index=False)
    done = study("all", f"--config={folder / 'bot.yaml'}", *SMALL)
    assert done.code == 2
    assert "logs/7.csv: column 'v', line 5" in done.err
    assert not (tmp_path / "results").exists()


def test_inspect_writes_a_configuration_that_runs(
    inside: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = study("inspect", "logs/*.csv", "--write=seen.yaml")
    assert done.code == 0, done
    settings = strict_yaml.parse((inside / "seen.yaml").read_text(encoding="utf-8"))["seen"]
    assert (settings["state"], settings["action"], settings["time"]) == (["x", "v"], ["u"], "t")
    again = study("inspect", "logs/*.csv", "--write=seen.yaml")
    assert again.code == 2
    assert "exists" in again.err
    done = study("all", "--config=seen.yaml", *SMALL, "--grid.models=[probabilistic_mlp]")
    assert done.code == 0, done
    assert read_json(inside / "results/seen/study.json")["settings"]["seen"]["time"] == "t"
