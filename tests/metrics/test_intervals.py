"""Bootstrap intervals: their coverage, pairing, counts and infinite values."""

import numpy as np
import pytest
from scipy.stats import bootstrap

from study.metrics.intervals import difference, interval, resampled_means


def crossed(generator: np.random.Generator, seeds: int, scenarios: int) -> np.ndarray:
    """Values around 0 that vary by seed, by scenario and by both."""
    return (
        0.5 * generator.normal(size=(seeds, 1))
        + generator.normal(size=(1, scenarios))
        + generator.normal(size=(seeds, scenarios))
    )


@pytest.mark.parametrize(("seeds", "least"), [(1, 0.90), (12, 0.88)])
def test_coverage(seeds: int, least: float) -> None:
    """With one seed only its own mean over scenarios can be covered; with many, the truth."""
    generator = np.random.default_rng(0)
    hits = 0
    for repetition in range(200):
        values = crossed(generator, seeds, 80)
        if seeds == 1:
            values = generator.normal(size=(1, 80))
        found = interval(values, resamples=400, seed=repetition)
        hits += found.low <= 0 <= found.high
    assert least <= hits / 200 <= 0.99


def test_one_seed_agrees_with_scipy() -> None:
    values = np.random.default_rng(0).normal(size=(1, 100))
    found = interval(values, resamples=20_000)
    theirs = bootstrap((values[0],), np.mean, n_resamples=20_000, method="percentile", rng=1)
    assert found.low == pytest.approx(theirs.confidence_interval.low, abs=0.01)
    assert found.high == pytest.approx(theirs.confidence_interval.high, abs=0.01)


def test_seeds_that_differ_widen_the_interval() -> None:
    noise = np.random.default_rng(0).normal(size=(1, 200))
    alike = interval(np.repeat(noise, 5, axis=0))
    unlike = interval(noise + np.array([-1, -0.5, 0, 0.5, 1])[:, None])
    assert unlike.high - unlike.low > 2 * (alike.high - alike.low)


def test_copies_of_a_seed_add_nothing() -> None:
    noise = np.random.default_rng(0).normal(size=(1, 200))
    one, five = interval(noise), interval(np.repeat(noise, 5, axis=0))
    assert five.high - five.low == pytest.approx(one.high - one.low, rel=0.1)


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


def test_counts_and_repeatability() -> None:
    values = np.random.default_rng(0).normal(size=(3, 50))
    found = interval(values)
    assert (found.seeds, found.scenarios) == (3, 50)
    assert found == interval(values)
    assert found != interval(values, seed=1)
    assert found.low < found.estimate < found.high


def test_a_tie_has_an_interval_of_no_width() -> None:
    values = np.random.default_rng(0).normal(size=(2, 30))
    found = difference(values, values.copy())
    assert (found.estimate, found.low, found.high) == (0, 0, 0)


def test_steps_are_resampled_together() -> None:
    values = np.random.default_rng(0).normal(size=(2, 30, 4))
    together = resampled_means(values, resamples=50)
    for step in range(4):
        alone = resampled_means(values[..., step], resamples=50)
        np.testing.assert_allclose(together[:, step], alone)


def test_an_infinite_score_makes_the_interval_infinite_and_nothing_else() -> None:
    values = np.random.default_rng(0).normal(size=(2, 50))
    values[1, 7] = np.inf
    found = interval(values)
    assert found.estimate == found.high == np.inf
    assert not np.isnan(found.low)
    means = resampled_means(values)
    # Both the seed and the scenario must be in the resample: 3/4 and 1 - (49/50)^50.
    assert np.isinf(means).mean() == pytest.approx(0.75 * (1 - 0.98**50), abs=0.05)
    assert np.isfinite(means[~np.isinf(means)]).all()
