"""MMD against a double loop and closed forms; non-finite forecasts; bandwidths; kernel score."""

import numpy as np
import pytest
import scoringrules

from study.common.arrays import Floats
from study.metrics.mmd import FLOOR, bandwidths, kernel_score, mmd

SCALE = np.array([2.0, 0.5])
BANDWIDTH = np.array([0.7, 1.3])


def normal(*shape: int, seed: int = 0) -> Floats:
    return np.random.default_rng(seed).standard_normal(shape, dtype=np.float32)


def mean_kernel(x: Floats, y: Floats, bandwidth: float, distinct: bool) -> float:
    total, count = 0.0, 0
    for i, a in enumerate(x):
        for j, b in enumerate(y):
            if distinct and i == j:
                continue
            total += np.exp(-((float(a) - float(b)) ** 2) / (2 * bandwidth**2))
            count += 1
    return total / count


def similarity(observed: Floats, scale: np.ndarray, bandwidth: np.ndarray) -> np.ndarray:
    """Mean kernel between two different rollouts [S, L, T, D]: [S, T, D]."""
    values = np.moveaxis(observed.astype(np.float64) / (scale * bandwidth), 1, -1)
    kernel = np.exp(-((values[..., :, None] - values[..., None, :]) ** 2) / 2)
    count = observed.shape[1]
    return np.asarray((kernel.sum((-1, -2)) - count) / (count * (count - 1)))


def slow(x: Floats, y: Floats, bandwidth: float) -> tuple[float, float]:
    """Unbiased MMD² and biased MMD of x [K] and y [L], by definition."""
    across = mean_kernel(x, y, bandwidth, False)
    unbiased = mean_kernel(x, x, bandwidth, True) + mean_kernel(y, y, bandwidth, True) - 2 * across
    biased = mean_kernel(x, x, bandwidth, False) + mean_kernel(y, y, bandwidth, False) - 2 * across
    return unbiased, np.sqrt(biased)


def test_agrees_with_a_double_loop() -> None:
    # Far from zero, as a position in metres may be: float32 must not show.
    forecast = normal(2, 5, 3, 2) + 30
    observed = normal(2, 4, 3, 2, seed=1) * 1.5 + 30.2
    result = mmd(forecast, observed, SCALE, BANDWIDTH)
    for s, t, d in np.ndindex(2, 3, 2):
        unbiased, biased = slow(forecast[s, :, t, d], observed[s, :, t, d], SCALE[d] * BANDWIDTH[d])
        assert result.squared[s, t, d] == pytest.approx(unbiased, abs=5e-9)
        assert result.biased[s, t, d] == pytest.approx(biased, abs=1e-6)


@pytest.mark.parametrize(
    ("deviation", "offset"), [(300.0, 0.0), (1.0, 1e3), (0.0, 0.2), (1e-9, 0.0)]
)
@pytest.mark.parametrize("bandwidth", [1.0, 1e-3])
@pytest.mark.parametrize("samples", [2, 9])
def test_agrees_with_a_double_loop_at_any_range(
    deviation: float, offset: float, bandwidth: float, samples: int
) -> None:
    forecast = np.float32(deviation) * normal(1, samples, 6, 1) + np.float32(offset)
    observed = normal(1, 5, 6, 1, seed=1)
    observed[:, :, 3] = observed[:, :1, 3]  # all rollouts agree
    forecast[:, 1:, 4] = observed[:, :1, 4]  # ties between the two
    result = mmd(forecast, observed, np.ones(1), np.array([bandwidth]))
    for t in range(6):
        unbiased, biased = slow(forecast[0, :, t, 0], observed[0, :, t, 0], bandwidth)
        assert result.squared[0, t, 0] == pytest.approx(unbiased, abs=5e-9)
        assert result.biased[0, t, 0] == pytest.approx(biased, abs=1e-4)
        assert result.biased[0, t, 0] ** 2 == pytest.approx(biased**2, abs=5e-9)


def test_many_samples_lose_nothing_to_float32() -> None:
    forecast, observed = normal(1, 300, 1, 1), normal(1, 200, 1, 1, seed=1)
    x, y = (z[0, :, 0, 0].astype(np.float64) for z in (forecast, observed))
    kernel = [np.exp(-((a[:, None] - b) ** 2) / 2) for a, b in ((x, x), (y, y), (x, y))]
    exact = sum((k.sum() - len(k)) / (len(k) * (len(k) - 1)) for k in kernel[:2])
    exact -= 2 * kernel[2].mean()
    result = mmd(forecast, observed, np.ones(1), np.ones(1))
    assert result.squared.item() == pytest.approx(exact, abs=2e-7)


@pytest.mark.parametrize(("shift", "deviation"), [(0.0, 1.0), (1.0, 1.0), (0.5, 2.0)])
def test_agrees_with_the_closed_form_of_two_normals(shift: float, deviation: float) -> None:
    """E k(x, y) = h / √(h² + v) · exp(-m² / 2(h² + v)), where x - y ~ N(m, v)."""

    def expected(mean: float, variance: float, h: float = 1.0) -> float:
        total = h**2 + variance
        return float(h / np.sqrt(total) * np.exp(-(mean**2) / (2 * total)))

    forecast = shift + deviation * normal(20, 40, 50, 1)
    result = mmd(forecast, normal(20, 40, 50, 1, seed=1), np.ones(1), np.ones(1))
    true = expected(0, 2 * deviation**2) + expected(0, 2) - 2 * expected(shift, 1 + deviation**2)
    standard_error = result.squared.std() / np.sqrt(result.squared.size)
    assert standard_error < 0.003
    # For equal distributions the true value is 0: this is the test that it is unbiased.
    assert result.squared.mean() == pytest.approx(true, abs=4 * standard_error)


def test_biased_mmd_is_positive_for_equal_distributions() -> None:
    result = mmd(normal(50, 100, 1, 1), normal(50, 100, 1, 1, seed=1), np.ones(1), np.ones(1))
    assert result.biased.min() > 0
    assert result.biased.mean() == pytest.approx(0.088, abs=0.01)


def test_scenarios_do_not_affect_each_other() -> None:
    forecast, observed = normal(5, 4, 2, 2), normal(5, 6, 2, 2, seed=1)
    whole = mmd(forecast, observed, SCALE, BANDWIDTH).squared
    part = mmd(forecast[3:4], observed[3:4], SCALE, BANDWIDTH).squared
    np.testing.assert_array_equal(whole[3:4], part)


def test_units_do_not_matter() -> None:
    forecast, observed = normal(2, 5, 3, 2), normal(2, 5, 3, 2, seed=1)
    metres = mmd(forecast, observed, SCALE, BANDWIDTH).squared
    millimetres = mmd(1000 * forecast, 1000 * observed, 1000 * SCALE, BANDWIDTH).squared
    np.testing.assert_allclose(metres, millimetres, atol=1e-6)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 3e38])
def test_non_finite_forecasts_are_the_worst_case(bad: float) -> None:
    observed = normal(1, 6, 1, 1)
    not_finite = np.full((1, 5, 1, 1), bad, np.float32)
    among = similarity(observed, np.ones(1), np.ones(1))
    # Kernel 1 among forecasts, 0 with the observed.
    result = mmd(not_finite, observed, np.ones(1), np.ones(1))
    np.testing.assert_allclose(result.squared, 1 + among, atol=5e-9)
    # No finite forecast is worse, wherever it is.
    for offset in (0.0, 3.0, 1e6):
        finite = np.full_like(not_finite, offset)
        assert mmd(finite, observed, np.ones(1), np.ones(1)).squared <= result.squared + 1e-12


def test_a_share_that_is_not_finite_costs_its_share() -> None:
    forecast, observed = normal(1, 5, 1, 1), normal(1, 6, 1, 1, seed=1)
    forecast[0, :2, 0, 0] = np.nan, np.inf
    x, y = forecast[0, 2:, 0, 0], observed[0, :, 0, 0]
    pairs = 3 * mean_kernel(x, x, 1, True) + 7  # three finite pairs, seven with kernel 1
    across = mean_kernel(x, y, 1, False) * 3 / 5
    expected = pairs / 10 + mean_kernel(y, y, 1, True) - 2 * across
    result = mmd(forecast, observed, np.ones(1), np.ones(1))
    assert result.squared.item() == pytest.approx(expected, abs=1e-6)


def test_bad_observations_and_too_few_samples_are_refused() -> None:
    observed = normal(2, 5, 3, 2)
    with pytest.raises(ValueError, match="at least two"):
        mmd(normal(2, 1, 3, 2), observed, SCALE, BANDWIDTH)
    with pytest.raises(ValueError, match="at least two"):
        bandwidths(observed[:, :1], SCALE)
    observed[0, 0, 0, 0] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        mmd(normal(2, 5, 3, 2), observed, SCALE, BANDWIDTH)


def test_progress_ends_at_one() -> None:
    fractions: list[float] = []
    observed = normal(4, 3, 2, 2)
    mmd(normal(4, 3, 2, 2, seed=1), observed, SCALE, BANDWIDTH, progress=fractions.append)
    assert fractions == [0.25, 0.5, 0.75, 1.0]


def test_bandwidth_is_the_median_distance() -> None:
    # The median of |x - y| for two standard normals is 0.954; the scale cancels the deviation.
    observed = 2 * normal(100, 20, 10, 1)
    assert bandwidths(observed, np.array([2.0])) == pytest.approx(0.954, abs=0.02)


def test_bandwidth_ignores_ties_and_has_a_floor() -> None:
    observed = normal(20, 10, 30, 3)
    observed[:, :, :20, 0] = 1.0  # at rest most of the time
    observed[..., 1] = 5.0  # at rest always
    observed[..., 2] *= 1e-4  # hardly moving
    bandwidth = bandwidths(observed, np.array([1.0, 0.0, 1.0]))
    assert bandwidth[0] == pytest.approx(0.954, abs=0.1)
    assert list(bandwidth[1:]) == [FLOOR, FLOOR]


def test_a_dimension_that_never_varies_scores_zero() -> None:
    forecast, observed = np.ones((2, 4, 3, 1), np.float32), np.ones((2, 5, 3, 1), np.float32)
    assert not mmd(forecast, observed, np.zeros(1), np.array([FLOOR])).squared.any()


def test_kernel_score_agrees_with_scoringrules() -> None:
    forecast, observation = normal(3, 7, 4, 2), normal(3, 4, 2, seed=1)
    unit = SCALE * BANDWIDTH
    fair = scoringrules.gksuv_ensemble(
        (observation / unit).astype(np.float64),
        (forecast / unit).astype(np.float64),
        m_axis=1,
        estimator="fair",
        backend="numpy",
    )
    # Theirs is half of MMD², constant k(y, y) = 1 included.
    expected = (2 * fair - 1).mean()
    assert kernel_score(forecast, observation, SCALE, BANDWIDTH) == pytest.approx(
        expected, abs=1e-6
    )


def test_kernel_score_is_mmd_up_to_a_term_of_the_observed() -> None:
    """The mean score over many observations is MMD² less the term that no forecast changes."""
    forecast, observed = normal(1, 6, 3, 2), normal(1, 40, 3, 2, seed=1)
    repeated = np.repeat(forecast, 40, axis=0)
    score = kernel_score(repeated, observed[0], SCALE, BANDWIDTH)
    squared = mmd(forecast, observed, SCALE, BANDWIDTH).squared
    among = similarity(observed, SCALE, BANDWIDTH)
    assert score == pytest.approx((squared - among).mean(), abs=1e-6)


def test_kernel_score_is_proper_and_penalises_non_finite_forecasts() -> None:
    observation = normal(20, 50, 1, seed=1)
    one = np.ones(1)
    right, narrow = normal(20, 8, 50, 1), 0.2 * normal(20, 8, 50, 1)
    not_finite = right.copy()
    not_finite[:, :2] = np.nan
    best = kernel_score(right, observation, one, one)
    assert best < kernel_score(narrow, observation, one, one)
    assert best < kernel_score(not_finite, observation, one, one)
    assert kernel_score(np.full_like(right, np.inf), observation, one, one) == pytest.approx(1)


def test_mmd_against_one_observation_is_one_plus_the_kernel_score() -> None:
    rng = np.random.default_rng(0)
    forecast, observed = rng.normal(size=(4, 9, 3, 2)), rng.normal(size=(4, 1, 3, 2))
    scale, bandwidth = np.ones(2), np.full(2, 0.7)
    squared = mmd(forecast, observed, scale, bandwidth).squared
    assert squared.mean() == pytest.approx(
        1 + kernel_score(forecast, observed[:, 0], scale, bandwidth)
    )


def test_mmd_against_one_observation_is_lowest_for_the_true_distribution() -> None:
    rng = np.random.default_rng(1)
    observed = rng.normal(size=(1000, 1, 1, 1))
    true, narrow, shifted_by = (
        rng.normal(mean, std, size=(1000, 20, 1, 1)) for mean, std in ((0, 1), (0, 0.3), (0.7, 1))
    )
    scores = [
        mmd(forecast, observed, np.ones(1), np.ones(1)).squared.mean()
        for forecast in (true, narrow, shifted_by)
    ]
    assert scores[0] < min(scores[1:])
