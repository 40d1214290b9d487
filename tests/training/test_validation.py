"""The validation score: MMD² at evenly spaced steps, as on the test set."""

import math

import numpy as np
import pytest

from study.data.kernel import Kernel
from study.metrics.mmd import mmd
from study.training.validation import MOST_STEPS, validation_mmd2


@pytest.mark.parametrize("horizon", [7, MOST_STEPS, 2 * MOST_STEPS, 2 * MOST_STEPS + 5])
def test_the_score_is_the_mmd_of_evenly_spaced_steps(horizon: int) -> None:
    generator = np.random.default_rng(0)
    forecasts = generator.normal(size=(3, 5, horizon, 2)).astype(np.float32)
    observed = generator.normal(1.0, size=(3, 4, horizon, 2)).astype(np.float32)
    kernel = Kernel(("a", "b"), np.array([1.0, 2.0]), np.array([0.5, 0.7]))
    every = math.ceil(horizon / MOST_STEPS)
    steps = list(range(horizon - 1, -1, -every))
    expected = mmd(forecasts, observed, kernel.scale, kernel.bandwidth).squared[:, steps].mean()
    assert len(steps) <= MOST_STEPS
    assert validation_mmd2(forecasts, observed, kernel) == pytest.approx(expected, abs=1e-8)
