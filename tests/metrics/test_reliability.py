"""The decomposition is exact and unbiased; the reliability curve by hand."""

from collections.abc import Callable

import numpy as np
import pytest

from study.metrics.brier import brier_fair
from study.metrics.reliability import BINS, Decomposition, decompose, group_of, reliability_curve

Forecaster = Callable[[np.random.Generator, int], tuple[np.ndarray, np.ndarray]]


def sampled(probability: np.ndarray, count: int, generator: np.random.Generator) -> np.ndarray:
    return generator.random((len(probability), count)) < probability[:, None]


def mixed(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples [S, K] of a fair forecaster, rollouts [S, L], and which samples are finite."""
    generator = np.random.default_rng(seed)
    true = generator.random(60)
    issued = np.clip(true + generator.normal(0, 0.2, 60), 0, 1)
    samples, rollouts = sampled(issued, 9, generator), sampled(true, 7, generator)
    return samples, rollouts, generator.random((60, 9)) < 0.9


def plain_murphy(probability: np.ndarray, frequency: np.ndarray) -> Decomposition:
    """Murphy's decomposition of the plain Brier score, without bias correction."""
    group = group_of(probability, smallest=1)
    count = np.maximum(np.bincount(group, minlength=BINS), 1)
    bias = (np.bincount(group, probability - frequency, BINS) / count)[group]
    reliability, base = float((bias**2).mean()), frequency.mean()
    score = np.mean(frequency * (1 - probability) ** 2 + (1 - frequency) * probability**2)
    uncertainty = float(base * (1 - base))
    return Decomposition(reliability, reliability + uncertainty - float(score), uncertainty)


def terms(found: Decomposition) -> list[float]:
    return [found.reliability, found.resolution, found.uncertainty]


def test_terms_sum_to_the_score() -> None:
    forecast, observed, valid = mixed()
    fair = pytest.approx(brier_fair(forecast, observed).mean())
    assert decompose(forecast, observed).score == fair
    assert decompose(forecast, observed, np.ones_like(valid)).score == fair


def test_agrees_with_ferro_and_fricker_where_forecasts_have_no_noise() -> None:
    """Their section 3, with one observation of each forecast, and forecasts of 0 and 1."""
    generator = np.random.default_rng(3)
    issued = generator.random(50) < 0.4
    happened = generator.random(50) < np.where(issued, 0.7, 0.2)
    total, base = len(issued), happened.mean()
    reliability = resolution = 0.0
    for value in (False, True):
        chosen = happened[issued == value]
        count, mean = len(chosen), chosen.mean()
        noise = mean * (1 - mean) / (count - 1)
        reliability += count / total * ((value - mean) ** 2 - noise)
        resolution += count / total * ((mean - base) ** 2 - noise)
    of_base = base * (1 - base) / (total - 1)
    expected = [reliability, resolution + of_base, base * (1 - base) + of_base]
    found = decompose(np.repeat(issued[:, None], 5, axis=1), happened[:, None])
    np.testing.assert_allclose(terms(found), expected)


def test_order_of_samples_does_not_matter() -> None:
    forecast, observed, valid = mixed()
    order = np.random.default_rng(1).permutation(9)
    expected = terms(decompose(forecast, observed, valid))
    found = decompose(forecast[:, order], observed[:, ::-1], valid[:, order])
    np.testing.assert_allclose(terms(found), expected)


def perfect(generator: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    true = generator.beta(0.6, 0.6, count)
    return true, true


def overconfident(generator: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    true = generator.uniform(0, 0.7, count)
    return true + 0.2, true


def base_rate(generator: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    return np.full(count, 0.5), generator.random(count)


@pytest.mark.parametrize(
    ("forecaster", "reliability", "resolution", "uncertainty"),
    [
        (perfect, 0, 0.25 / 2.2, 0.25),
        (overconfident, 0.04, 0.49 / 12, 0.35 * 0.65),
        (base_rate, 0, 0, 0.25),
    ],
)
@pytest.mark.parametrize(("samples", "rollouts", "scenarios"), [(5, 3, 30), (20, 10, 60)])
def test_terms_are_unbiased(
    forecaster: Forecaster,
    reliability: float,
    resolution: float,
    uncertainty: float,
    samples: int,
    rollouts: int,
    scenarios: int,
) -> None:
    generator = np.random.default_rng(samples)
    corrected, plain = [], []
    for _ in range(300):
        issued, true = forecaster(generator, scenarios)
        forecast = sampled(issued, samples, generator)
        observed = sampled(true, rollouts, generator)
        corrected.append(terms(decompose(forecast, observed)))
        plain.append(terms(plain_murphy(forecast.mean(1), observed.mean(1))))
    error = np.std(corrected, axis=0) / np.sqrt(len(corrected))
    expected = np.array([reliability, resolution, uncertainty])
    assert (abs(np.mean(corrected, axis=0) - expected) < 4 * error).all()
    # The correction is needed: the bias of the plain terms is larger than chance.
    assert np.mean(plain, axis=0)[0] - reliability > 4 * error[0]


def test_one_non_finite_sample_makes_the_terms_the_worst() -> None:
    observed = sampled(np.full(30, 0.3), 8, np.random.default_rng(0))
    valid = np.ones((30, 6), bool)
    finite = decompose(valid, observed, valid)
    valid[4, 2] = False
    found = decompose(np.ones_like(valid), observed, valid)
    assert (found.reliability, found.resolution, found.score) == (np.inf, -np.inf, np.inf)
    assert found.uncertainty == finite.uncertainty


def test_an_outcome_that_always_happens_leaves_nothing_to_know() -> None:
    always = np.ones((12, 6), bool)
    np.testing.assert_allclose(terms(decompose(always, always)), 0, atol=1e-12)
    never_forecast = decompose(~always, always)
    np.testing.assert_allclose(terms(never_forecast), [1, 0, 0], atol=1e-12)


def test_one_scenario_is_too_few() -> None:
    forecast, observed, _ = mixed()
    assert np.isnan(terms(decompose(forecast[:1], observed[:1]))).all()


def test_bins() -> None:
    shares = np.array([0, 0.1, 0.3, 7 / 10, 0.999, 1])
    np.testing.assert_array_equal(group_of(shares, smallest=1), [0, 1, 3, 7, 9, 9])
    np.testing.assert_array_equal(group_of(np.arange(10) / 10, smallest=1), np.arange(10))
    lonely = group_of(np.array([0.05, 0.05, 0.45, 0.85, 0.85]))
    np.testing.assert_array_equal(np.bincount(lonely)[np.bincount(lonely) > 0], [3, 2])
    assert len(set(group_of(np.array([0.0, 0.5, 1.0]), smallest=9))) == 1


def test_curve_by_hand() -> None:
    forecast = np.repeat([0.12, 0.18, 0.9], [6, 6, 20])
    observed = np.repeat([0.0, 0.5, 0.9], [6, 6, 20])
    curve = reliability_curve(forecast, observed)
    np.testing.assert_allclose(curve.forecast, [0.15, 0.9])
    np.testing.assert_allclose(curve.observed, [0.25, 0.9])
    np.testing.assert_array_equal(curve.count, [12, 20])
    # 12 scenarios, half of them at 0.5: a standard error of 0.25 / √12.
    assert curve.low[0] == pytest.approx(0.25 - 1.96 * 0.25 / np.sqrt(12), abs=0.03)
    assert curve.high[0] == pytest.approx(0.25 + 1.96 * 0.25 / np.sqrt(12), abs=0.03)
    np.testing.assert_allclose([curve.low[1], curve.high[1]], 0.9)


def test_curve_of_one_seed_is_that_of_itself_twice() -> None:
    forecast, observed, _ = mixed()
    probability, frequency = forecast.mean(1), observed.mean(1)
    one = reliability_curve(probability, frequency)
    two = reliability_curve(np.stack([probability, probability]), frequency)
    np.testing.assert_allclose(two.observed, one.observed)
    np.testing.assert_array_equal(two.count, 2 * one.count)
    np.testing.assert_allclose(two.low, one.low, atol=0.03)


def test_intervals_of_the_curve_cover() -> None:
    generator = np.random.default_rng(0)
    covered = []
    for _ in range(150):
        true = generator.random(200)
        observed = sampled(true, 20, generator).mean(1)
        curve = reliability_curve(true, observed, bins=5)
        covered.append((curve.low <= curve.forecast) & (curve.forecast <= curve.high))
    assert 0.88 < np.mean(covered) < 0.99
