"""Where one step is bimodal, a VAE needs its latent variable, and uses it."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from paper_figs.posteriors import COLLAPSED_BELOW
from study.commands.settings import CONFIGS
from study.common.seeds import spawn
from study.config.names import FULL, MLP
from study.examples.fork import HOP
from study.models.checkpoints import load_model
from tests.helpers.running import study

FORK = ["--config", CONFIGS / "fork.yaml", "--engine.kind=serial"]
MIDDLE = 0.3 * HOP
"""A position between the two modes, for a puck that starts in the middle."""


def in_the_middle(forecaster_file: Path) -> float:
    """The share of one-step forecasts between the two modes, for a puck that starts there."""
    s0, actions = np.zeros((8, 1), np.float32), np.zeros((8, 4, 1), np.float32)
    forecasts = load_model(forecaster_file).forecast(s0, actions, 500, spawn(3, 8))
    return float((np.abs(forecasts[:, :, 0, 0]) < MIDDLE).mean())


@pytest.mark.slow
def test_a_live_posterior_forecasts_two_modes_and_a_collapsed_one_does_not(tmp_path: Path) -> None:
    live, collapsed = tmp_path / "live", tmp_path / "collapsed"
    assert study("all", *FORK, "--out", live).code == 0
    large_beta = ["--tune.beta_low=100", "--tune.beta_high=1000", f"--grid.models=[{FULL}]"]
    assert study("all", *FORK, *large_beta, "--out", collapsed).code == 0

    used, unused = fit(live), fit(collapsed)
    assert used["kl"] > 5 * COLLAPSED_BELOW
    assert used["latent_share"] > 0.9
    assert used["active_units"] >= 1
    assert unused["kl"] < 0.1 * COLLAPSED_BELOW
    assert unused["latent_share"] < 0.05
    assert "used" in (live / "tables" / "posteriors.md").read_text()
    assert "collapsed |" in (collapsed / "tables" / "posteriors.md").read_text()

    normal_step = mmd2(live, MLP)
    assert mmd2(live, FULL) < 0.4 * normal_step
    assert mmd2(collapsed, FULL) > 0.8 * normal_step

    weights = f"weights/fork/low/{FULL}/seed-0.safetensors"
    assert in_the_middle(live / weights) < 0.1
    assert in_the_middle(collapsed / weights) > 0.15


def fit(out: Path) -> "pd.Series[float]":
    """The row of the full VAE in ``fits.parquet``."""
    fits = pd.read_parquet(out / "fits.parquet")
    (row,) = [row for _, row in fits.iterrows() if row["model"] == FULL]
    return row


def mmd2(out: Path, model: str) -> float:
    """The model's MMD² on the test set."""
    scores = pd.read_parquet(out / "scores.parquet")
    rows = scores[(scores["metric"] == "mmd2") & (scores["model"] == model)]
    rows = rows[(rows["step"] == -1) & (rows["dimension"] == "all")]
    return float(rows["value"].mean())
