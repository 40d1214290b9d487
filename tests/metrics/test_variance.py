"""Variance ratios of distributions with known variances, and the law of total variance."""

import numpy as np
import pytest

from study.metrics.variance import (
    FIRST_STEP,
    NEGLIGIBLE,
    aleatoric_ratio,
    decompose,
    epistemic_share,
    mean_of_known,
    median_of_known,
    median_ratio,
    split,
    variance_ratio,
)


def normal(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape, dtype=np.float32)


def test_ratio_of_known_variances() -> None:
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
def test_the_ratio_of_a_non_finite_forecast_is_infinite(bad: float) -> None:
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


MEANS = np.array([-1.0, 0.0, 0.5, 2.5])
DEVIATIONS = np.array([0.5, 1.0, 2.0, 0.7])


def of_members(member: np.ndarray, seed: int = 0) -> np.ndarray:
    """Samples [S, K, 1, 1] of members with known means and standard deviations."""
    noise = np.random.default_rng([seed, 1]).normal(size=member.shape)
    return (30 + MEANS[member] + DEVIATIONS[member] * noise)[:, :, None, None]


@pytest.mark.parametrize("samples", [2, 3, 6, 40])
def test_decomposition_is_unbiased_for_any_number_of_samples(samples: int) -> None:
    scenarios = 4000
    member = np.random.default_rng(samples).integers(0, 4, (scenarios, samples))
    forecast = of_members(member)
    predicted = decompose(forecast, member)
    aleatoric, epistemic = np.mean(DEVIATIONS**2), MEANS.var()
    expected = {
        "total": aleatoric + epistemic,
        "aleatoric": aleatoric,
        "epistemic": epistemic,
    }
    blocks = np.array_split(np.arange(scenarios), 40)
    parts = [decompose(forecast[block], member[block]) for block in blocks]
    for part, value in expected.items():
        of_blocks = [getattr(each, part).item() for each in parts]
        error = np.std(of_blocks) / np.sqrt(len(blocks))
        assert error < 0.15
        assert getattr(predicted, part).item() == pytest.approx(value, abs=4 * error)
    if samples == 6:
        # `split` is biased: a part of the noise is in its epistemic part.
        assert split(forecast, member).epistemic.mean() > 1.1 * epistemic


def test_decomposition_of_variances_by_hand() -> None:
    member = np.array([[0, 0, 0, 1, 1, 2]])
    values = np.array([1.0, 2.0, 6.0, 10.0, 14.0, 99.0])
    predicted = decompose(values[None, :, None, None], member)
    within = np.var([1, 2, 6], ddof=1) * 2 + np.var([10, 14], ddof=1)  # one sample: no weight
    assert predicted.aleatoric.item() == pytest.approx(within / 3)
    assert predicted.total.item() == pytest.approx(np.var(values, ddof=1))
    assert predicted.epistemic.item() == pytest.approx(np.var(values, ddof=1) - within / 3)


def test_members_with_one_sample_each_say_nothing() -> None:
    forecast = normal(2, 3, 2, 1)
    twice, once = np.array([[0, 0, 1], [1, 2, 2]]), np.array([[0, 1, 2]] * 2)
    alone = decompose(forecast[1:], twice[1:])
    mixed = decompose(forecast, np.stack([once[0], twice[1]]))
    np.testing.assert_allclose(mixed.aleatoric, alone.aleatoric)
    np.testing.assert_allclose(mixed.total, decompose(forecast).total)
    none = decompose(forecast, once)
    assert np.isnan(none.aleatoric).all()
    assert np.isnan(none.epistemic).all()
    np.testing.assert_allclose(none.total, mixed.total)


def test_without_an_ensemble_all_variance_is_aleatoric() -> None:
    forecast, observed, scale = normal(5, 6, 3, 2), normal(5, 7, 3, 2, seed=1), np.ones(2)
    predicted = decompose(forecast)
    np.testing.assert_array_equal(predicted.aleatoric, predicted.total)
    assert not epistemic_share(predicted, scale).any()
    np.testing.assert_array_equal(
        aleatoric_ratio(predicted, observed, scale), variance_ratio(forecast, observed, scale)
    )


def test_aleatoric_ratio_leaves_out_what_members_disagree_on() -> None:
    member = np.random.default_rng(3).integers(0, 4, (2000, 20))
    forecast = of_members(member)
    aleatoric = np.mean(DEVIATIONS**2)
    observed = np.sqrt(aleatoric) * normal(2000, 20, 1, 1, seed=4)
    predicted, scale = decompose(forecast, member), np.ones(1)
    share = MEANS.var() / (MEANS.var() + aleatoric)
    assert aleatoric_ratio(predicted, observed, scale).item() == pytest.approx(1, abs=0.05)
    assert epistemic_share(predicted, scale).item() == pytest.approx(share, abs=0.02)
    assert variance_ratio(forecast, observed, scale).item() == pytest.approx(
        1 / (1 - share), rel=0.05
    )


@pytest.mark.parametrize("ensemble", [False, True])
def test_a_decomposition_that_is_not_finite_or_negligible(ensemble: bool) -> None:
    forecast, observed = normal(4, 8, 3, 1), normal(4, 8, 3, 1, seed=1)
    forecast[0, 0, 0, 0] = np.nan
    forecast[:, :, 1] = 0.9 * NEGLIGIBLE * np.sign(forecast[:, :, 1])
    observed[:, :, 2] = 5.0
    member = np.tile(np.arange(8) % 3, (4, 1)) if ensemble else None
    predicted = decompose(forecast, member)
    assert np.isinf(predicted.total[0])
    assert np.isinf(predicted.aleatoric[0])
    assert np.isnan(predicted.epistemic[0])
    ratio, share = (
        aleatoric_ratio(predicted, observed, np.ones(1)),
        epistemic_share(predicted, np.ones(1)),
    )
    assert [np.isinf(ratio.item(i)) for i in range(3)] == [True, False, False]
    assert [np.isnan(ratio.item(i)) for i in range(3)] == [False, False, True]
    assert [np.isnan(share.item(i)) for i in range(3)] == [True, True, False]


def test_the_median_ignores_nan_and_a_few_large_values_but_nothing_infinite() -> None:
    ratio = np.array([[1.0, np.nan, 3.0], [np.nan, 2.0, 1e9]])
    assert median_of_known(ratio) == 2.5
    assert np.isnan(median_of_known(np.full((2, 3), np.nan)))
    # One value in six that is not finite would move the median of ratios below 1 towards 1.
    ratio[0, 1] = np.inf
    assert median_of_known(ratio) == np.inf


def test_the_main_ratio_is_from_the_first_step_on() -> None:
    step = np.arange(1, 15)
    ratio = np.stack([np.where(step < FIRST_STEP, 7.0, step), np.where(step < FIRST_STEP, 7, 2)])
    assert median_ratio(ratio, step) == np.median([11, 12, 13, 14, 2, 2, 2, 2])
    # A horizon that ends before: its last step.
    assert median_ratio(ratio[:, :5] * step[:5], step[:5]) == 35
    assert np.isnan(median_ratio(np.empty((2, 0)), np.empty(0)))


def test_mean_of_known_values() -> None:
    values = np.array([[1.0, np.nan, 3.0], [np.nan, np.nan, np.inf]])
    np.testing.assert_array_equal(mean_of_known(values, 0), [1, np.nan, np.inf])
    np.testing.assert_array_equal(mean_of_known(values, 1), [2, np.inf])
    assert mean_of_known(values[0]) == 2
    assert np.isnan(mean_of_known(values[:, 1]))
