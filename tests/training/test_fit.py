"""What training is stopped on and what it logs."""

import numpy as np
import pytest
import torch

from study.metrics.mmd import mmd
from study.models.base import LOG_EVERY
from study.training.fit import SCORED_STEPS, validation_score
from tests.helpers.models import model


@pytest.mark.parametrize("horizon", [7, SCORED_STEPS, 2 * SCORED_STEPS, 2 * SCORED_STEPS + 5])
def test_the_score_is_the_mmd_of_every_few_steps(horizon: int) -> None:
    generator = np.random.default_rng(0)
    forecasts = generator.normal(size=(3, 5, horizon, 2)).astype(np.float32)
    observed = generator.normal(1.0, size=(3, 4, horizon, 2)).astype(np.float32)
    scale, bandwidth = np.array([1.0, 2.0]), np.array([0.5, 0.7])
    every = -(-horizon // SCORED_STEPS)
    steps = list(range(horizon - 1, -1, -every))
    expected = mmd(forecasts, observed, scale, bandwidth).squared[:, steps].mean()
    found = validation_score(scale, bandwidth)(forecasts, observed)
    assert len(steps) <= SCORED_STEPS
    assert found == pytest.approx(expected, abs=1e-8)


def test_curves_have_a_point_every_few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    network, points = model("full_vae"), []
    for step in range(3 * LOG_EVERY):
        monkeypatch.setattr(type(network), "global_step", step)
        monkeypatch.setattr(network, "log_dict", lambda values, at=step: points.append(at))
        network.tell({"loss": torch.tensor(1.0)})
    # Lightning writes at these steps: see `log_every_n_steps`.
    assert points == [LOG_EVERY - 1, 2 * LOG_EVERY - 1, 3 * LOG_EVERY - 1]
