"""Brier score against scikit-learn, and by hand."""

import numpy as np
import pytest
from sklearn.metrics import brier_score_loss

from study.metrics.brier import brier, climatology, skill, two_class


def outcomes(*shape: int, seed: int, p: float = 0.4) -> np.ndarray:
    return np.random.default_rng(seed).random(shape) < p


def test_agrees_with_scikit_learn() -> None:
    forecast, observed = outcomes(20, 9, seed=0), outcomes(20, 7, seed=1, p=0.6)
    probability = np.repeat(forecast.mean(1), 7)
    expected = brier_score_loss(observed.ravel(), probability)
    assert brier(forecast, observed).mean() == pytest.approx(expected)


def test_climatology_agrees_with_scikit_learn() -> None:
    observed = outcomes(20, 7, seed=1)
    probability = np.full(observed.size, observed.mean())
    expected = brier_score_loss(observed.ravel(), probability)
    assert climatology(observed).mean() == pytest.approx(expected)


def test_by_hand() -> None:
    forecast = np.array([[True, True, False, False], [True, True, True, True]])
    observed = np.array([[True, False], [True, False]])
    np.testing.assert_allclose(brier(forecast, observed), [0.25, 0.5])
    assert two_class(brier(forecast, observed)).mean() == pytest.approx(0.75)


def test_perfect_and_hopeless() -> None:
    sure = np.array([[True] * 5, [False] * 5])
    np.testing.assert_array_equal(brier(sure, sure), [0, 0])
    np.testing.assert_array_equal(brier(sure, ~sure), [1, 1])


@pytest.mark.parametrize("claimed", [True, False])
def test_a_sample_that_is_not_finite_is_wrong_either_way(claimed: bool) -> None:
    forecast = np.full((1, 4), claimed)
    nothing = np.zeros((1, 4), bool)
    for happened in (True, False):
        observed = np.full((1, 3), happened)
        assert brier(forecast, observed, nothing) == pytest.approx(1)


def test_one_bad_sample_never_helps() -> None:
    forecast, observed = outcomes(50, 8, seed=0), outcomes(50, 6, seed=1)
    valid = np.ones_like(forecast)
    valid[:, 0] = False
    worst = brier(forecast, observed, valid)
    either = []
    for value in (True, False):
        forecast[:, 0] = value
        either.append(brier(forecast, observed))
    assert (worst >= np.maximum(*either) - 1e-12).all()
    assert worst.mean() > max(score.mean() for score in either)


def test_skill_is_a_ruler_from_climatology_to_oracle() -> None:
    assert skill(0.24, oracle=0.16, reference=0.24) == 0
    assert skill(0.16, oracle=0.16, reference=0.24) == 1
    assert skill(0.32, oracle=0.16, reference=0.24) == pytest.approx(-1)
    assert np.isnan(skill(0.1, oracle=0.2, reference=0.2))
