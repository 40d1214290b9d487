"""Coverage and PIT: by definition, of an oracle, of wrong variances, with ties."""

import numpy as np
import pytest

from study.metrics.calibration import coverage, pit, rank_histogram, share_below

PROBABILITIES = (0.5, 0.8, 0.9)


def normal(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape, dtype=np.float32)


def slow_share_below(samples: np.ndarray, rollouts: np.ndarray, value: float) -> float:
    """The share of rollouts [L] whose PIT among samples [K] is below a value, one at a time."""
    total = 0.0
    for y in rollouts:
        low = sum(x < y for x in samples) / (len(samples) + 1)
        high = (sum(x <= y for x in samples) + 1) / (len(samples) + 1)
        total += min(max((value - low) / (high - low), 0), 1)
    return total / len(rollouts)


def test_agrees_with_the_definition_with_and_without_ties() -> None:
    forecast, observed = normal(3, 7, 2, 3), normal(3, 6, 2, 3, seed=1)
    forecast[..., 1], observed[..., 1] = forecast[..., 1].round(), observed[..., 1].round()
    ranks = rank_histogram(forecast, observed)
    assert ranks.shape == (2, 3, 10)
    assert not ranks[..., [0, -1]].any()
    values = (0.0, 0.05, 0.3, 0.5, 0.77, 1.0)
    for t, d in np.ndindex(2, 3):
        for value, share in zip(values, share_below(ranks, values)[t, d], strict=True):
            slow = [
                slow_share_below(x[:, t, d], y[:, t, d], value)
                for x, y in zip(forecast, observed, strict=True)
            ]
            assert share == pytest.approx(np.mean(slow))


@pytest.mark.parametrize("samples", [3, 40, 100])
def test_the_oracle_is_calibrated_for_any_number_of_samples(samples: int) -> None:
    centre = 5 * normal(600, 1, 4, 2, seed=2)
    forecast, observed = (centre + normal(600, n, 4, 2, seed=n) for n in (samples, 30))
    ranks = rank_histogram(forecast, observed)
    for probability in PROBABILITIES:
        # Standard error: at most 0.004 with three samples, which all rollouts share.
        assert coverage(ranks, probability).mean() == pytest.approx(probability, abs=0.012)
    shares = pit(ranks).mean((0, 1))
    np.testing.assert_allclose(shares, 0.05, atol=0.006)


@pytest.mark.parametrize("samples", [3, 40, 100])
def test_every_order_of_exchangeable_values_averages_exactly_to_nominal(samples: int) -> None:
    """Each of K + 1 values in turn is the observed one, the others are the forecast: no chance."""
    values = normal(samples + 1)
    forecast = np.stack([np.delete(values, i) for i in range(samples + 1)])[:, :, None, None]
    ranks = rank_histogram(forecast, values[:, None, None, None])
    np.testing.assert_allclose(ranks[..., 1:-1], 1 / (samples + 1))
    for probability in PROBABILITIES:
        assert coverage(ranks, probability).item() == pytest.approx(probability)
    np.testing.assert_allclose(pit(ranks), 0.05)


def test_a_wrong_variance_and_a_bias_have_their_shapes() -> None:
    observed = normal(300, 20, 1, 1, seed=1)
    narrow, wide, low = (
        rank_histogram(f(normal(300, 100, 1, 1)), observed)
        for f in (lambda x: x / 3, lambda x: 3 * x, lambda x: x - 1)
    )
    for probability, z in zip(PROBABILITIES, (0.6745, 1.2816, 1.6449), strict=True):
        # P(|y| < z/3) and P(|y| < 3z) of a standard normal y, from a large sample of it.
        sample = np.abs(normal(400_000, seed=9))
        assert coverage(narrow, probability).item() == pytest.approx(
            (sample < z / 3).mean(), abs=0.02
        )
        assert coverage(wide, probability).item() == pytest.approx(
            (sample < 3 * z).mean(), abs=0.02
        )
    u_shape, hump, slope = (pit(ranks)[0, 0] for ranks in (narrow, wide, low))
    assert min(u_shape[0], u_shape[-1]) > 0.2 > 5 * u_shape[10]
    assert max(hump[0], hump[-1]) < 0.01 < hump[10]
    assert slope[-1] > 0.15 > 0.01 > slope[0]


def test_constant_forecasts_are_uniform_where_they_are_right_and_outside_where_not() -> None:
    forecast = np.full((4, 11, 2, 1), 3.0, np.float32)
    observed = np.full((4, 5, 2, 1), 3.0, np.float32)
    observed[:, :, 1] = 3.001
    right, wrong = rank_histogram(forecast, observed)
    np.testing.assert_allclose(right[:, 1:-1], 1 / 12)
    np.testing.assert_allclose(pit(right), 0.05)
    assert coverage(right, 0.5).item() == pytest.approx(0.5)
    np.testing.assert_allclose(wrong[0], np.eye(14)[12])
    assert coverage(wrong, 0.8).item() == 0


def test_coverage_is_the_sum_of_the_bins_within() -> None:
    ranks = rank_histogram(normal(5, 9, 3, 2), normal(5, 8, 3, 2, seed=1))
    shares = pit(ranks)
    np.testing.assert_allclose(shares.sum(-1), 1)
    for probability, outside in zip(PROBABILITIES, (5, 2, 1), strict=True):
        within = shares[..., outside:-outside].sum(-1)
        np.testing.assert_allclose(coverage(ranks, probability), within)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_non_finite_forecasts_cover_nothing(bad: float) -> None:
    forecast, observed = normal(4, 9, 2, 1), normal(4, 7, 2, 1, seed=1)
    before = rank_histogram(forecast, observed)
    others = rank_histogram(forecast[1:], observed[1:])
    forecast[0, 3, 0, 0] = bad
    after = rank_histogram(forecast, observed)
    np.testing.assert_allclose(after[1], before[1])
    worst = np.eye(12)[[0, 11]].sum(0) / 2
    np.testing.assert_allclose(after[0], 0.75 * others[0] + 0.25 * worst)
    not_finite = rank_histogram(np.full_like(forecast, bad), observed)
    assert (coverage(not_finite, 0.9) == -np.inf).all()
    assert [np.isinf(value) for value in coverage(after, 0.9)[:, 0]] == [True, False]
    np.testing.assert_allclose(pit(not_finite)[..., [0, -1]], 0.5)


def test_non_finite_observations_are_refused() -> None:
    forecast, observed = normal(2, 5, 3, 2), normal(2, 4, 3, 2, seed=1)
    observed[0, 0, 0, 0] = np.inf
    with pytest.raises(ValueError, match="not finite"):
        rank_histogram(forecast, observed)
