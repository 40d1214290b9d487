"""Brier score against scikit-learn, scoringrules and hand calculation; skill."""

import numpy as np
import pytest
import scoringrules
from sklearn.metrics import brier_score_loss

from study.metrics.brier import (
    SMALLEST_RANGE,
    brier,
    brier_fair,
    brier_oracle,
    climatology,
    skill,
    two_class,
)


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


def test_skill_is_zero_for_the_climatology_and_one_for_the_oracle() -> None:
    assert skill(0.24, oracle=0.16, climatology=0.24) == 0
    assert skill(0.16, oracle=0.16, climatology=0.24) == 1
    assert skill(0.32, oracle=0.16, climatology=0.24) == pytest.approx(-1)


def test_skill_is_undefined_where_the_oracle_gains_nothing() -> None:
    assert np.isnan(skill(0.1, oracle=0.2, climatology=0.2))
    assert np.isnan(skill(0.1, oracle=0.2 - 0.9 * SMALLEST_RANGE, climatology=0.2))
    assert np.isnan(skill(0.1, oracle=0.21, climatology=0.2))


def test_the_oracle_expects_the_fair_score_of_the_true_probability() -> None:
    observed = outcomes(40_000, 4, seed=0, p=0.3)
    of_oracle = brier_oracle(observed.mean(1), 4)
    assert of_oracle.mean() == pytest.approx(0.3 * 0.7, abs=0.005)
    np.testing.assert_allclose(of_oracle, observed.var(1, ddof=1))
    forecast = outcomes(40_000, 5, seed=1, p=0.3)
    assert brier_fair(forecast, observed).mean() == pytest.approx(0.3 * 0.7, abs=0.005)


def test_trailing_axes_are_scored_separately() -> None:
    forecast, observed = outcomes(6, 5, 4, seed=0), outcomes(6, 3, 4, seed=1)
    valid = outcomes(6, 5, seed=2, p=0.8)
    for metric in (brier, brier_fair):
        by_step = metric(forecast, observed, valid)
        assert by_step.shape == (6, 4)
        for t in range(4):
            alone = metric(forecast[..., t], observed[..., t], valid)
            np.testing.assert_allclose(by_step[:, t], alone)
    np.testing.assert_allclose(climatology(observed)[:, 2], climatology(observed[..., 2]))


def test_agrees_with_scoringrules() -> None:
    forecast, observed = outcomes(20, 9, seed=0), outcomes(20, 7, seed=1)
    expected = scoringrules.brier_score(observed.astype(float), forecast.mean(1)[:, None])
    np.testing.assert_allclose(brier(forecast, observed), expected.mean(1))


def test_fair_is_the_fair_crps_of_zeros_and_ones() -> None:
    forecast, observed = outcomes(20, 9, seed=0), outcomes(20, 7, seed=1)
    members = np.repeat(forecast[:, None].astype(float), 7, axis=1)
    expected = scoringrules.crps_ensemble(observed.astype(float), members, estimator="fair")
    np.testing.assert_allclose(brier_fair(forecast, observed), expected.mean(1), atol=1e-12)


@pytest.mark.parametrize("samples", [2, 5, 40])
@pytest.mark.parametrize("p", [0.1, 0.5])
def test_fair_expects_the_score_of_the_probability_itself(samples: int, p: float) -> None:
    observed = np.array([[True, True, False, False, False]])
    forecast = outcomes(40_000, samples, seed=samples, p=p)
    scores = brier_fair(forecast, np.repeat(observed, len(forecast), axis=0))
    of_probability = 0.4 * (1 - p) ** 2 + 0.6 * p**2
    error = scores.std() / np.sqrt(len(scores))
    assert scores.mean() == pytest.approx(of_probability, abs=4 * error)
    plain = brier(forecast, np.repeat(observed, len(forecast), axis=0))
    assert plain.mean() == pytest.approx(of_probability + p * (1 - p) / samples, abs=4 * error)


def test_fair_expects_the_score_of_infinitely_many_samples_of_which_some_are_not_finite() -> None:
    forecast, valid = outcomes(40_000, 3, seed=0), outcomes(40_000, 3, seed=1, p=0.8)
    observed = np.repeat([[True, False, False, False]], len(forecast), axis=0)
    scores = brier_fair(forecast, observed, valid)
    success, failure = 0.4 * 0.8, 0.6 * 0.8
    expected = 0.25 * (1 - success) ** 2 + 0.75 * (1 - failure) ** 2
    error = scores.std() / np.sqrt(len(scores))
    assert scores.mean() == pytest.approx(expected, abs=4 * error)


def test_fair_by_hand() -> None:
    forecast = np.array([[True, True, False, False], [True, True, True, True]])
    observed = np.array([[True, False], [True, False]])
    np.testing.assert_allclose(brier_fair(forecast, observed), [0.25 - 0.25 / 3, 0.5])


def test_one_sample_cannot_be_scored_fairly() -> None:
    with pytest.raises(ValueError, match="2 samples or more"):
        brier_fair(outcomes(3, 1, seed=0), outcomes(3, 4, seed=1))
