"""CRPS and energy score against `scoringrules` and closed forms; non-finite forecasts."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import scoringrules

from study.common.arrays import Doubles, Floats
from study.metrics.proper_scores import crps, energy_score

Score = Callable[..., Doubles]

SCALE = np.array([2.0, 0.5, 3.0])
ONE = np.ones(1)


def normal(*shape: int, seed: int = 0) -> Floats:
    return np.random.default_rng(seed).standard_normal(shape, dtype=np.float32)


def case() -> tuple[Floats, Floats]:
    """Far from zero, as a position in metres may be, and with ties."""
    forecast, observed = normal(3, 9, 25, 3) + 30, normal(3, 7, 25, 3, seed=1) * 1.5 + 30.2
    forecast[:, 1] = forecast[:, 0]
    observed[:, :4] = forecast[:, :4]
    return forecast, observed


def test_crps_is_that_of_scoringrules() -> None:
    forecast, observed = case()
    x, y = forecast.astype(np.float64) / SCALE, observed.astype(np.float64) / SCALE
    reference = np.mean(
        [
            scoringrules.crps_ensemble(y[:, i], x, m_axis=1, estimator="fair", backend="numpy")
            for i in range(y.shape[1])
        ],
        axis=0,
    )
    np.testing.assert_allclose(crps(forecast, observed, SCALE), reference, atol=1e-6)


def test_energy_score_is_that_of_scoringrules() -> None:
    forecast, observed = case()
    x, y = forecast.astype(np.float64) / SCALE, observed.astype(np.float64) / SCALE
    reference = np.mean(
        [
            scoringrules.es_ensemble(y[:, i], x, m_axis=1, estimator="fair", backend="numpy")
            for i in range(y.shape[1])
        ],
        axis=0,
    )
    np.testing.assert_allclose(energy_score(forecast, observed, SCALE), reference, atol=1e-6)


def test_energy_score_of_one_dimension_is_the_crps() -> None:
    forecast, observed = normal(4, 30, 5, 1), normal(4, 20, 5, 1, seed=1)
    marginal = crps(forecast, observed, ONE)[..., 0]
    np.testing.assert_allclose(energy_score(forecast, observed, ONE), marginal, atol=1e-6)


@pytest.mark.parametrize(("shift", "deviation"), [(0.0, 1.0), (1.0, 1.0), (0.0, 0.3)])
def test_crps_agrees_with_the_closed_form_for_normals(shift: float, deviation: float) -> None:
    """E |N(m, v)| for the differences; fair, so it does not depend on the number of samples."""

    def expected(m: float, sd: float) -> float:
        density = math.exp(-(m**2) / (2 * sd**2)) * math.sqrt(2 / math.pi)
        return sd * density + m * math.erf(m / sd / math.sqrt(2))

    true = expected(shift, np.hypot(1, deviation)) - expected(0, np.sqrt(2) * deviation) / 2
    for samples in (2, 10):
        forecast = shift + deviation * normal(200, samples, 60, 1)
        score = crps(forecast, normal(200, 10, 60, 1, seed=1), ONE)
        error = score.std() / np.sqrt(score.size)
        assert error < 0.01
        assert score.mean() == pytest.approx(true, abs=4 * error)


def test_scores_are_proper() -> None:
    observed = normal(20, 30, 10, 2, seed=1)
    for score in (crps, energy_score):
        right = score(normal(20, 40, 10, 2), observed, np.ones(2)).mean()
        for wrong in (0.3 * normal(20, 40, 10, 2), 2 * normal(20, 40, 10, 2)):
            assert right + 0.01 < score(wrong, observed, np.ones(2)).mean()


def test_energy_score_depends_on_dependence_and_crps_does_not() -> None:
    both = normal(40, 60, 10, 1, seed=1)
    observed = np.concatenate([both, both], -1)
    one = normal(40, 60, 10, 1)
    dependent, mirrored = (np.concatenate([one, sign * one], -1) for sign in (1, -1))
    two = np.ones(2)
    gap = energy_score(mirrored, observed, two) - energy_score(dependent, observed, two)
    assert gap.mean() > 0.1
    marginal = crps(mirrored, observed, two).mean() - crps(dependent, observed, two).mean()
    assert abs(marginal) < 0.02


@pytest.mark.parametrize("score", [crps, energy_score])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_the_score_of_a_non_finite_forecast_is_infinite_at_its_place(
    score: Score, bad: float
) -> None:
    forecast, observed = normal(2, 5, 3, 2), normal(2, 6, 3, 2, seed=1)
    before = score(forecast, observed, np.ones(2))
    forecast[0, 1, 2, 1] = bad
    after = score(forecast, observed, np.ones(2))
    index = (0, 2, 1) if score is crps else (0, 2)
    assert after[index] == np.inf
    after[index] = before[index]
    np.testing.assert_allclose(after, before, atol=1e-12)


@pytest.mark.parametrize("score", [crps, energy_score])
def test_a_forecast_that_is_large_but_finite_is_not_clipped(score: Score) -> None:
    forecast, observed = normal(1, 4, 1, 1), normal(1, 6, 1, 1, seed=1)
    forecast[:] = 3e38
    assert score(forecast, observed, ONE).item() == pytest.approx(3e38, rel=1e-6)


@pytest.mark.parametrize("score", [crps, energy_score])
def test_units_do_not_matter_and_a_constant_dimension_scores_zero(score: Score) -> None:
    forecast, observed = case()
    metres = score(forecast, observed, SCALE)
    np.testing.assert_allclose(
        score(1000 * forecast, 1000 * observed, 1000 * SCALE), metres, atol=1e-5
    )
    constant = np.full((1, 5, 2, 1), 7.0, np.float32)
    np.testing.assert_allclose(score(constant, constant[:, :3], np.zeros(1)), 0, atol=1e-12)


@pytest.mark.parametrize("score", [crps, energy_score])
def test_bad_observations_and_too_few_samples_are_refused(score: Score) -> None:
    observed = normal(2, 5, 3, 2)
    with pytest.raises(ValueError, match="at least two"):
        score(observed[:, :1], observed, np.ones(2))
    bad = observed.copy()
    bad[0, 0, 0, 0] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        score(observed, bad, np.ones(2))
