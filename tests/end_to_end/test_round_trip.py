"""The training data of a simulator, exported and read back as logs, give the same scores."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from study.metrics.intervals import Interval, interval
from tests.helpers.running import study

HORIZON = 20
LEARNED = ["probabilistic_mlp", "ensemble"]
SIZES = [
    "--engine.kind=serial",
    "--grid.models=[probabilistic_mlp]",
    "--ensemble.members=3",
    "--ensemble.hidden_size=16",
    "--ensemble.steps=100",
    "--ensemble.validate_every=50",
    "--mlp.hidden_size=32",
    "--train.steps=200",
    "--train.validate_every=100",
    "--evaluate.samples=20",
    "--evaluate.examples=1",
    "--collect.scenarios=40",
]
SIMULATED = [
    *SIZES,
    "--grid.environments=[pusher]",
    "--grid.levels=[low]",
    "--collect.trajectories=150",
    f"--collect.horizon={HORIZON}",
    "--collect.validation=20",
    "--collect.rollouts=2",
]

pytestmark = pytest.mark.slow


def crps_of(results: Path, model: str) -> Interval:
    """The mean CRPS over scenarios, with its interval."""
    scores = pd.read_parquet(results / "scores.parquet")
    rows = scores[(scores["metric"] == "crps") & (scores["model"] == model)]
    rows = rows[(rows["scenario"] >= 0) & (rows["step"] == -1) & (rows["dimension"] == "all")]
    return interval(rows["value"].to_numpy(np.float64)[None])


def test_logs_of_the_pusher_give_the_scores_of_the_simulated_pusher(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    simulated = study("all", *SIMULATED, "--out=simulated")
    assert simulated.code == 0, simulated
    assert study("export", "pusher", *SIMULATED, "--name=trip", "--to=logs").code == 0
    (folder,) = (tmp_path / "logs").rglob("trip-*")
    written = study("inspect", folder, f"--horizon={HORIZON}", "--write=trip.yaml")
    assert written.code == 0, written
    done = study("all", "--config=trip.yaml", *SIZES, "--out=read_back")
    assert done.code == 0, done
    for model in LEARNED:
        one, other = (crps_of(tmp_path / name, model) for name in ("simulated", "read_back"))
        assert one.low < other.high, (model, one, other)
        assert other.low < one.high, (model, one, other)
        # Both are far better than the training climatology.
        climatology = crps_of(tmp_path / "read_back", "training_climatology")
        assert max(one.estimate, other.estimate) < climatology.estimate
