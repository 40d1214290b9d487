"""Every metric: a forecast with values that are not finite never scores better for them.

Random forecasts lose a random share of their values. The score must be at least as bad as that of
the forecast before, and as that of the forecast with any finite values in place of the lost ones.
"""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

from study.common.arrays import Array, Doubles
from study.metrics.brier import brier, brier_fair
from study.metrics.calibration import coverage, rank_histogram
from study.metrics.joint_mmd import joint_mmd
from study.metrics.mmd import kernel_score, mmd, pooled, sensitivity, shifted
from study.metrics.proper_scores import crps, energy_score
from study.metrics.reliability import decompose as decompose_brier
from study.metrics.tables.scores import Outcomes, score
from study.metrics.variance import (
    aleatoric_ratio,
    decompose,
    mean_of_known,
    median_of_known,
    variance_ratio,
)

SCALE, BANDWIDTH = np.array([2.0, 0.5]), np.array([0.7, 1.3])
KERNEL = (SCALE, BANDWIDTH)
PROBABILITIES = (0.5, 0.8, 0.9)
TOLERANCE = 1e-6
CASES = range(25)

Badness = Callable[[Array, Array, Array], Array | float]
"""From forecasts [S, K, T, D], observed rollouts and members: higher is worse, of any shape."""


def distance_of_ratio(ratio: Doubles) -> Doubles:
    """How far variance ratios are from 1; 0 where the true variance is negligible."""
    with np.errstate(divide="ignore"):
        return np.nan_to_num(np.abs(np.log(ratio)), nan=0.0, posinf=np.inf)


def distance_of_coverage(forecast: Array, observed: Array, averaged: bool) -> Doubles:
    """How far coverages are from nominal, at each step and dimension or on average."""
    ranks = rank_histogram(forecast, observed)
    found = np.stack([coverage(ranks, probability) for probability in PROBABILITIES])
    found = found.mean((1, 2)) if averaged else found
    return np.abs(found.T - PROBABILITIES)


METRICS: dict[str, Badness] = {
    "MMD²": lambda x, y, _: mmd(x, y, *KERNEL).squared,
    "biased MMD": lambda x, y, _: mmd(x, y, *KERNEL).biased,
    "other bandwidths": lambda x, y, _: np.stack(
        [found.squared for found in sensitivity(x, y, *KERNEL)]
    ),
    "pooled MMD²": lambda x, y, _: pooled(x, y, *KERNEL).squared,
    "pooled biased MMD": lambda x, y, _: pooled(x, y, *KERNEL).biased,
    "joint MMD²": lambda x, y, _: joint_mmd(x, y, *KERNEL).squared,
    "joint biased MMD": lambda x, y, _: joint_mmd(x, y, *KERNEL).biased,
    "reference shift": lambda x, y, _: mmd(shifted(x, y, 0.3), y, *KERNEL).squared,
    "kernel score": lambda x, y, _: kernel_score(x, y[:, 0], *KERNEL),
    "CRPS": lambda x, y, _: crps(x, y, SCALE),
    "energy score": lambda x, y, _: energy_score(x, y, SCALE),
    "coverage": lambda x, y, _: distance_of_coverage(x, y, averaged=False),
    "average coverage": lambda x, y, _: distance_of_coverage(x, y, averaged=True),
    "variance ratio": lambda x, y, _: distance_of_ratio(variance_ratio(x, y, SCALE)),
    "mean variance ratio": lambda x, y, _: distance_of_ratio(
        mean_of_known(variance_ratio(x, y, SCALE))
    ),
    "median variance ratio": lambda x, y, _: distance_of_ratio(
        np.asarray(median_of_known(variance_ratio(x, y, SCALE)))
    ),
    "aleatoric ratio": lambda x, y, m: distance_of_ratio(
        aleatoric_ratio(decompose(x, m), y, SCALE)
    ),
}


def case(number: int) -> tuple[Array, Array, Array, Array]:
    """A random forecast, which of its values are lost, rollouts and members."""
    generator = np.random.default_rng(number)
    scenarios, samples, rollouts, steps = generator.integers([1, 2, 2, 1], [4, 9, 8, 4])
    centre = generator.normal(size=(scenarios, 1, steps, 2))
    spread = generator.choice([0.0, 0.05, 1.0, 4.0], 2)
    shape = (scenarios, samples, steps, 2)
    forecast = centre + generator.choice([0, 0.5, 3]) + spread * generator.normal(size=shape)
    observed = centre + generator.normal(size=(scenarios, rollouts, steps, 2))
    lost = generator.random(shape) < generator.choice([0.02, 0.2, 0.6, 1.0])
    lost[tuple(generator.integers(shape))] = True
    member = generator.integers(0, 3, (scenarios, samples))
    return forecast.astype(np.float32), lost, observed.astype(np.float32), member


def replacements(forecast: Array, observed: Array, generator: np.random.Generator) -> list[Array]:
    """Finite values in place of lost ones, each of the shape of the forecast."""
    shape = forecast.shape
    one = np.broadcast_to(generator.normal(size=(1, 1, 1, 2)) * 3, shape)
    return [
        forecast,
        np.roll(forecast, 1, axis=1),
        np.broadcast_to(observed[:, :1], shape),
        np.broadcast_to(observed.mean(1, keepdims=True), shape),
        np.broadcast_to(forecast.mean(1, keepdims=True), shape),
        one,
        one + 1e3,
        np.full(shape, 1e30),
        generator.choice([-1e30, 1e30], shape),
        generator.normal(size=shape) * 10,
    ]


@pytest.mark.parametrize("number", CASES)
@pytest.mark.parametrize("metric", METRICS)
def test_no_finite_values_in_place_of_lost_ones_score_worse(metric: str, number: int) -> None:
    badness = METRICS[metric]
    forecast, lost, observed, member = case(number)
    generator = np.random.default_rng([number, 1])
    not_finite = generator.choice(np.array([np.nan, np.inf, -np.inf], np.float32), forecast.shape)
    found = np.asarray(badness(np.where(lost, not_finite, forecast), observed, member))
    assert not np.isnan(found).any()
    for values in replacements(forecast, observed, generator):
        replaced = np.where(lost, values, forecast).astype(np.float32)
        assert (found >= np.asarray(badness(replaced, observed, member)) - TOLERANCE).all()


@pytest.mark.parametrize("number", CASES)
def test_no_outcomes_in_place_of_lost_ones_score_worse(number: int) -> None:
    generator = np.random.default_rng(number)
    scenarios, samples, rollouts = generator.integers([2, 2, 2], [8, 8, 8])
    forecast = generator.random((scenarios, samples)) < generator.random((scenarios, 1))
    observed = generator.random((scenarios, rollouts)) < generator.random((scenarios, 1))
    valid = generator.random(forecast.shape) < generator.choice([0.0, 0.3, 0.9])
    valid[tuple(generator.integers(forecast.shape))] = False
    terms = decompose_brier(forecast, observed, valid)
    for values in (forecast, ~forecast, np.zeros_like(forecast), np.ones_like(forecast)):
        replaced = np.where(valid, forecast, values)
        for rule in (brier, brier_fair):
            worst = rule(forecast, observed, valid)
            assert (worst >= rule(replaced, observed) - 1e-12).all()
        finite = decompose_brier(replaced, observed)
        assert terms.reliability >= finite.reliability
        assert terms.resolution <= finite.resolution
        assert terms.score >= finite.score


LOWER_IS_BETTER = (
    "mmd2",
    "mmd",
    "mmd2_half",
    "mmd2_double",
    "mmd2_joint",
    "mmd2_pooled",
    "mmd2_shift_0.1",
    "mmd2_shift_0.3",
    "mmd2_shift_1",
    "crps",
    "energy_score",
    "brier",
    "brier_fair",
    "brier_reliability",
    "brier_two_class",
    "nonfinite",
)
HIGHER_IS_BETTER = ("brier_resolution",)
COVERAGES = {f"coverage_{100 * probability:.0f}": probability for probability in PROBABILITIES}
RATIOS = ("variance_ratio", "aleatoric_ratio")
WITHOUT_ORDER = (
    "brier_uncertainty",
    "brier_climatology",
    "forecast_probability",
    "observed_probability",
    "epistemic_share",
    *(f"pit_{number:02}" for number in range(1, 21)),
)


def badness_of_table(table: pd.DataFrame) -> pd.Series:
    """How bad each score in a table is."""
    value, metric = table["value"].copy(), table["metric"]
    value[metric.isin(HIGHER_IS_BETTER)] *= -1
    for name, probability in COVERAGES.items():
        value[metric == name] = (value[metric == name] - probability).abs()
    ratio = metric.isin(RATIOS)
    value[ratio] = distance_of_ratio(value[ratio].to_numpy())
    return value[~metric.isin(WITHOUT_ORDER)]


@pytest.mark.parametrize("number", range(6))
def test_no_row_of_the_table_of_scores_is_better(number: int) -> None:
    """All averages too; a metric without a rule fails the test."""
    forecast, lost, observed, member = (
        np.tile(part, (3, *[1] * (part.ndim - 1))) for part in case(number)
    )

    def outcomes(values: Array) -> dict[str, Array]:
        return {"goal": np.asarray((values[..., 0] > 0).any(2))}

    def scored(values: Array) -> pd.DataFrame:
        by_step = [np.maximum.accumulate(v[..., 0] > 0, axis=2) for v in (values, observed)]
        both = Outcomes(outcomes(values), outcomes(observed), *by_step)
        return score(values, observed, both, *KERNEL, ["x", "y"], member, reference_shifts=True)

    table = scored(np.where(lost, np.float32(np.nan), forecast))
    known = {*LOWER_IS_BETTER, *HIGHER_IS_BETTER, *COVERAGES, *RATIOS, *WITHOUT_ORDER}
    assert set(table["metric"]) == known
    found = badness_of_table(table)
    for values in (forecast, np.broadcast_to(observed[:, :1], forecast.shape)):
        finite = scored(np.where(lost, values, forecast).astype(np.float32))
        worse = found >= badness_of_table(finite) - TOLERANCE
        assert worse.all(), table.loc[worse.index[~worse]]
