"""Variance ratio on distributions of known width, and the law of total variance."""

import numpy as np
import pytest

from study.metrics.variance import split, variance_ratio


def normal(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape, dtype=np.float32)


def test_ratio_of_known_widths() -> None:
    # A different mean in each scenario is no variance of a forecast.
    means = 10 * normal(1000, 1, 1, 1, seed=2)
    forecast = means + normal(1000, 30, 2, 3) * np.array([1, 2, 0.5])
    observed = means + normal(1000, 30, 2, 3, seed=1)
    ratio = variance_ratio(forecast, observed, np.ones(3))
    np.testing.assert_allclose(ratio, [[1, 4, 0.25]] * 2, rtol=0.05)


def test_ratio_is_of_averages() -> None:
    forecast = np.array([[1.0, -1.0], [3.0, -3.0]])[:, :, None, None]
    observed = np.array([[2.0, -2.0], [1.0, -1.0]])[:, :, None, None]
    assert variance_ratio(forecast, observed, np.ones(1)) == pytest.approx(10 / 5)


def test_no_true_variance_has_no_ratio() -> None:
    observed = normal(4, 5, 2, 2)
    observed[..., 0] = 3.0
    ratio = variance_ratio(normal(4, 5, 2, 2, seed=1), observed, np.array([1.0, 1.0]))
    assert np.isnan(ratio[:, 0]).all()
    assert np.isfinite(ratio[:, 1]).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_infinitely_wide(bad: float) -> None:
    forecast = normal(4, 5, 2, 1)
    forecast[0, 0, 0, 0] = bad
    ratio = variance_ratio(forecast, normal(4, 5, 2, 1, seed=1), np.ones(1))
    assert np.isinf(ratio[0, 0])
    assert np.isfinite(ratio[1, 0])


def test_law_of_total_variance() -> None:
    forecast = normal(3, 12, 4, 2)
    member = np.random.default_rng(1).integers(0, 4, (3, 12))
    parts = split(forecast, member)
    np.testing.assert_allclose(parts.total, forecast.var(1, dtype=np.float64), rtol=1e-9)
    np.testing.assert_allclose(parts.aleatoric + parts.epistemic, parts.total, rtol=1e-9)
    first = forecast[0, :, 0, 0].astype(np.float64)
    within = sum(
        first[member[0] == m].var() * (member[0] == m).mean() for m in np.unique(member[0])
    )
    assert parts.aleatoric[0, 0, 0] == pytest.approx(within)


def test_members_that_agree_or_do_nothing_else_but_disagree() -> None:
    member = np.repeat(np.arange(3), 4)[None]
    disagree = np.repeat(np.array([-1.0, 0.0, 1.0]), 4)[None, :, None, None]
    only_epistemic = split(disagree, member)
    assert only_epistemic.aleatoric.item() == pytest.approx(0)
    assert only_epistemic.epistemic.item() == pytest.approx(2 / 3)
    only_aleatoric = split(np.tile([1.0, -1.0], 6)[None, :, None, None], member)
    assert only_aleatoric.epistemic.item() == pytest.approx(0)
    assert only_aleatoric.aleatoric.item() == pytest.approx(1)
