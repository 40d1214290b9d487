"""Other readings of MMD: other bandwidths, scenarios pooled, and reference shifts."""

import numpy as np
import pytest

from study.common.arrays import Floats
from study.metrics.mmd import FACTORS, bandwidths, mmd, pooled, sensitivity, shifted

SCALE = np.array([2.0, 0.5])
BANDWIDTH = np.array([0.7, 1.3])


def normal(*shape: int, seed: int = 0) -> Floats:
    return np.random.default_rng(seed).standard_normal(shape, dtype=np.float32)


def test_sensitivity_is_mmd_at_other_bandwidths() -> None:
    forecast, observed = 2 * normal(3, 6, 4, 2), normal(3, 5, 4, 2, seed=1)
    forecast[0, 1, 2, 0], forecast[2, 3, 1, 1] = np.nan, 1e5
    found = sensitivity(forecast, observed, SCALE, BANDWIDTH)
    assert FACTORS == (0.5, 1.0, 2.0)
    for factor, at_factor in zip(FACTORS, found, strict=True):
        single = mmd(forecast, observed, SCALE, factor * BANDWIDTH)
        np.testing.assert_allclose(at_factor.squared, single.squared, rtol=0, atol=1e-8)
        np.testing.assert_allclose(at_factor.biased, single.biased, rtol=0, atol=1e-6)
    assert not np.allclose(found[0].squared, found[2].squared, atol=1e-2)


def test_progress_changes_nothing() -> None:
    forecast, observed = normal(4, 6, 4, 2), normal(4, 5, 4, 2, seed=1)
    shares: list[float] = []
    reported = mmd(forecast, observed, SCALE, BANDWIDTH, progress=shares.append)
    assert shares == [0.25, 0.5, 0.75, 1.0]
    silent = mmd(forecast, observed, SCALE, BANDWIDTH)
    assert reported.squared.tobytes() == silent.squared.tobytes()


def test_pooled_is_mmd_of_one_scenario_that_holds_all() -> None:
    forecast, observed = normal(3, 6, 4, 2), normal(3, 5, 4, 2, seed=1)
    forecast[0, 1, 2, 0], forecast[2, 3, 1, 1] = np.nan, 1e5
    shares: list[float] = []
    found = pooled(forecast, observed, SCALE, BANDWIDTH, shares.append)
    together = mmd(forecast.reshape(1, 18, 4, 2), observed.reshape(1, 15, 4, 2), SCALE, BANDWIDTH)
    np.testing.assert_allclose(found.squared, together.squared[0], rtol=0, atol=5e-9)
    np.testing.assert_allclose(found.biased, together.biased[0], rtol=0, atol=1e-6)
    assert shares == [0.25, 0.5, 0.75, 1.0]


def test_pooled_does_not_change_if_scenarios_are_swapped() -> None:
    places = 3 * normal(40, 1, 1, 1)
    observed, ones = places + normal(40, 20, 5, 1), np.ones(1)
    swapped = np.roll(places, 1, axis=0) + normal(40, 20, 5, 1, seed=1)
    assert mmd(swapped, observed, ones, ones).squared.mean() > 0.3
    assert abs(pooled(swapped, observed, ones, ones).squared.mean()) < 0.01


def test_pooled_has_the_bias_of_its_docstring() -> None:
    """Scenarios far apart: mean kernel 1/√3 within one for unit normals, 0 across."""
    scenarios, samples, steps = 5, 4, 400
    places = 1e3 * np.arange(scenarios, dtype=np.float64)[:, None, None, None]
    x, y = (places + normal(scenarios, samples, steps, 1, seed=seed) for seed in (0, 1))
    found = pooled(x, y, np.ones(1), np.ones(1)).squared
    total = scenarios * samples
    expected = -2 / np.sqrt(3) * (1 - 1 / scenarios) / (total - 1)
    error = found.std() / np.sqrt(steps)
    assert found.mean() == pytest.approx(expected, abs=4 * error)
    assert error < abs(expected) / 10


def test_reference_shifts_have_the_closed_form_of_two_normals() -> None:
    forecast, observed = 5 * normal(20, 60, 40, 1), 5 * normal(20, 60, 40, 1, seed=1)
    scale = np.array([5.0])
    previous = 0.0
    for by in (0.1, 0.3, 1.0):
        moved = shifted(forecast, observed, by)
        assert moved.dtype == forecast.dtype
        squared = mmd(moved, observed, scale, np.ones(1)).squared
        # See test_mmd: h = 1, variance of a difference 2.
        expected = 2 / np.sqrt(3) * (1 - np.exp(-(by**2) / 6))
        error = squared.std() / np.sqrt(squared.size)
        assert squared.mean() == pytest.approx(expected, abs=4 * error + 0.02 * expected)
        assert squared.mean() > previous + error
        previous = float(squared.mean())


def test_a_shift_is_in_units_of_each_scenario_step_and_dimension() -> None:
    observed = normal(2, 30, 3, 2) * np.array([[1.0, 4.0]], np.float32)
    observed[1, :, 2] = 7.0  # rollouts that agree move nothing
    moved = shifted(observed, observed, 0.3) - observed
    expected = np.broadcast_to(0.3 * observed.std(1, keepdims=True), moved.shape)
    np.testing.assert_allclose(moved, expected, atol=1e-5)
    assert not moved[1, :, 2].any()


@pytest.mark.parametrize("read", [sensitivity, pooled])
def test_bad_observations_and_too_few_samples_are_refused(read) -> None:  # type: ignore[no-untyped-def]
    observed = normal(2, 5, 3, 2)
    bandwidth = bandwidths(observed, SCALE)
    with pytest.raises(ValueError, match="at least two"):
        read(observed[:, :1], observed, SCALE, bandwidth)
    observed[1, 2, 0, 1] = np.inf
    with pytest.raises(ValueError, match="not finite"):
        read(observed, observed, SCALE, bandwidth)
