"""Intervals over seeds and scenarios: their coverage, pairing, counts and infinite values."""

import numpy as np
import pytest
from scipy import stats

from study.common.arrays import Doubles
from study.metrics.intervals import band, basis, difference, interval, sum_of_means, training_seeds

SCENARIOS = 250
VARIATION = {
    "MMD², Pusher": (0.0135, 0.0218, 0.0325),
    "MMD², UAV": (0.0030, 0.0154, 0.0126),
    "Brier score, Pusher": (0.0344, 0.1177, 0.0757),
    "Brier score, UAV": (0.0087, 0.0652, 0.0435),
}
"""Standard deviations of the effects of seed, scenario and both in contrasts of claims.

They are roots of mean variance components (analysis of variance) of the contrasts of
`study.claims.paper`, in the scores of `results/paper`.
"""


def crossed(
    variation: tuple[float, float, float],
    seeds: int,
    repetitions: int,
    scenarios: int = SCENARIOS,
) -> Doubles:
    """Values [seeds, S, repetitions] around 0 that vary by seed, by scenario and by both."""
    generator = np.random.default_rng([seeds, scenarios])
    by_seed, by_scenario, by_both = variation
    return (
        by_seed * generator.normal(size=(seeds, 1, repetitions))
        + by_scenario * generator.normal(size=(1, scenarios, repetitions))
        + by_both * generator.normal(size=(seeds, scenarios, repetitions))
    )


def covered(low: Doubles, high: Doubles) -> float:
    return float(((low <= 0) & (high >= 0)).mean())


def bootstrap(values: Doubles, resamples: int = 400) -> tuple[Doubles, Doubles]:
    """Percentile intervals by a bootstrap of seeds and scenarios: the method that does not hold."""
    generator = np.random.default_rng(0)
    seeds, scenarios, _ = values.shape
    by_seed, by_scenario = (
        generator.multinomial(n, np.full(n, 1 / n), resamples) / n for n in (seeds, scenarios)
    )
    means = sum(by_seed[:, [r]] * (by_scenario @ values[r]) for r in range(seeds))
    low, high = np.quantile(means, [0.025, 0.975], axis=0)
    return low, high


def satterthwaite(values: Doubles) -> tuple[Doubles, Doubles]:
    """A t interval with Satterthwaite's degrees of freedom, which does not hold either."""
    seeds, scenarios, _ = values.shape
    mean = values.mean((0, 1))
    rest = values - values.mean(0, keepdims=True) - values.mean(1, keepdims=True) + mean
    both = (seeds - 1) * (scenarios - 1)
    parts = np.stack(
        [
            values.mean(1).var(0, ddof=1) / seeds,
            values.mean(0).var(0, ddof=1) / scenarios,
            -(rest**2).sum((0, 1)) / both / (seeds * scenarios),
        ]
    )
    variance = np.maximum(parts.sum(0), 0)
    freedom = np.array([[seeds - 1], [scenarios - 1], [both]])
    degrees = np.maximum(variance**2 / (parts**2 / freedom).sum(0), 1)
    half = stats.t.ppf(0.975, degrees) * np.sqrt(variance)
    return mean - half, mean + half


@pytest.mark.parametrize("seeds", [2, 3, 5])
@pytest.mark.parametrize("what", VARIATION)
def test_the_level_holds_with_few_seeds(what: str, seeds: int) -> None:
    """Standard error of the coverage: 0.005."""
    found = band(crossed(VARIATION[what], seeds, 2000))
    assert 0.94 <= covered(found.low, found.high) <= 0.985


@pytest.mark.parametrize(("seeds", "most"), [(2, 0.75), (3, 0.85), (5, 0.91)])
def test_a_bootstrap_of_seeds_does_not_hold(seeds: int, most: float) -> None:
    values = crossed(VARIATION["Brier score, Pusher"], seeds, 400)
    assert covered(*bootstrap(values)) < most


def test_degrees_of_freedom_of_satterthwaite_do_not_hold() -> None:
    assert covered(*satterthwaite(crossed(VARIATION["Brier score, Pusher"], 2, 2000))) < 0.9


@pytest.mark.parametrize("seeds", [2, 3])
@pytest.mark.parametrize("scenarios", [4, 12])
@pytest.mark.parametrize(
    "variation", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.5, 1.0, 1.0)]
)
def test_the_level_is_never_missed(
    variation: tuple[float, float, float], scenarios: int, seeds: int
) -> None:
    found = band(crossed(variation, seeds, 20_000, scenarios))
    assert covered(found.low, found.high) >= 0.945


def test_two_environments_together() -> None:
    """The difference between two environments, each with seeds and scenarios of its own."""
    parts = [
        crossed(VARIATION["MMD², UAV"], 2, 2000),
        -crossed(VARIATION["MMD², Pusher"], 3, 2000, 100),
    ]
    found = sum_of_means(parts)
    assert 0.94 <= covered(found.low, found.high) <= 0.995
    np.testing.assert_allclose(found.estimate, parts[0].mean((0, 1)) + parts[1].mean((0, 1)))


def test_one_seed_is_a_t_interval_over_scenarios() -> None:
    values = np.random.default_rng(0).normal(size=(1, 100))
    found = interval(values)
    theirs = stats.ttest_1samp(values[0], 0).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((theirs.low, theirs.high))
    assert "scenarios only" in basis({1})
    assert "seeds and scenarios" in basis({2})
    assert "1 seed over scenarios only" in basis({1, 2})


def test_the_numbers_of_training_seeds_in_words() -> None:
    assert training_seeds({1}) == "1 training seed"
    assert training_seeds({5}) == "5 training seeds"
    assert training_seeds([5, 3, 1, 5]) == "1 to 5 training seeds"
    assert training_seeds(()) == "no training seeds"


def test_one_scenario_is_a_t_interval_over_seeds() -> None:
    values = np.random.default_rng(0).normal(size=(4, 1))
    found = interval(values)
    theirs = stats.ttest_1samp(values[:, 0], 0).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((theirs.low, theirs.high))


def test_one_value_has_no_interval() -> None:
    found = interval(np.array([[3.0]]))
    assert (found.estimate, found.low, found.high) == (3, -np.inf, np.inf)


def test_pairing_removes_the_variation_that_scenarios_share() -> None:
    generator = np.random.default_rng(0)
    shared = generator.normal(size=(1, 100))
    first = shared + 0.1 + 0.01 * generator.normal(size=(3, 100))
    second = shared + 0.01 * generator.normal(size=(3, 100))
    paired = difference(first, second)
    assert paired.estimate == pytest.approx(first.mean() - second.mean())
    assert paired.low > 0.09
    # The intervals of the two sides overlap.
    assert interval(first).low < interval(second).high


def test_counts() -> None:
    found = interval(np.random.default_rng(0).normal(size=(3, 50)))
    assert (found.seeds, found.scenarios) == (3, 50)
    assert found.low < found.estimate < found.high


def test_a_tie_has_an_interval_of_no_width() -> None:
    values = np.random.default_rng(0).normal(size=(2, 30))
    found = difference(values, values.copy())
    assert (found.estimate, found.low, found.high) == (0, 0, 0)


def test_a_band_is_the_interval_of_each_step() -> None:
    values = np.random.default_rng(0).normal(size=(2, 30, 4))
    found = band(values)
    for step in range(4):
        alone = interval(values[..., step])
        ends = found.estimate[step], found.low[step], found.high[step]
        assert ends == pytest.approx((alone.estimate, alone.low, alone.high))


def test_an_infinite_score_makes_the_interval_infinite_and_nothing_else() -> None:
    values = np.random.default_rng(0).normal(size=(2, 50, 2))
    values[1, 7, 0] = np.inf
    found = band(values)
    assert found.estimate[0] == found.low[0] == found.high[0] == np.inf
    assert np.isfinite([found.estimate[1], found.low[1], found.high[1]]).all()


def test_infinite_scores_on_both_sides_have_no_difference() -> None:
    values = np.random.default_rng(0).normal(size=(2, 50))
    values[0, 0] = np.inf
    found = difference(values, values)
    assert np.isnan(found.estimate)
    assert (found.low, found.high) == (-np.inf, np.inf)
