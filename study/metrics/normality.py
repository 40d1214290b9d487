"""Tests of two hypotheses about the distribution of points: Gaussian, and unimodal.

Each scenario has K points in D dimensions, such as the final positions of K rollouts. The tests
give a p-value for each scenario:

    Gaussian   Henze and Zirkler, "A class of invariant consistent tests for multivariate
               normality", Communications in Statistics 19, 1990
    unimodal   Hartigan and Hartigan, "The dip test of unimodality", Annals of Statistics 13, 1985

The null distribution of a statistic is simulated, with the same K and a fixed seed, from
`SIMULATIONS` samples under the hypothesis. The p-value is (1 + n) / (1 + SIMULATIONS), where n
simulated statistics are at least as large as the observed one. There is no asymptotic formula.

**Negligible variance.** Rollouts are stored in float32. A standard deviation of at most
`RESOLUTION` times the largest coordinate of all scenarios can be rounding, and counts as zero.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from study.common.arrays import Array, Doubles
from study.common.seeds import derive
from study.metrics.dip import dip

SIMULATIONS = 2000
"""Simulated samples under the hypothesis: enough for p-values far below the usual significance."""

RESOLUTION = 1e-6
"""Smallest standard deviation that is not rounding, as a share of the largest coordinate."""

BLOCK = 2_000_000
"""Pairs of points that are in memory at once."""


@dataclass(frozen=True)
class Rejections:
    """How many of `scenarios` hypotheses are rejected, each by its own test."""

    count: int
    scenarios: int
    significance: float

    @property
    def expected(self) -> float:
        """Expected number of rejections if every hypothesis is true, at most."""
        return self.significance * self.scenarios


def count_rejections(p_values: Array, significance: float = 0.01) -> Rejections:
    """Count the scenarios whose p-value [S] is at most `significance`."""
    return Rejections(
        int(np.sum(np.asarray(p_values) <= significance)), len(p_values), significance
    )


def not_gaussian(points: Array) -> Doubles:
    """P-value [S] of the Henze-Zirkler test that the points [S, K, D] are a Gaussian sample.

    The statistic is invariant under affine maps, so one simulation with N(0, I) is valid for all
    scenarios. A dimension that varies in no scenario is dropped. A scenario with a singular
    covariance, such as points on a line, has the smallest possible p-value: Henze and Zirkler
    assign to it the largest statistic, 4K. A scenario whose points are all equal has p = 1.

    Raises:
        ValueError: a value that is not finite, or K ≤ D + 1.
    """
    points = _doubles(points)
    smallest = RESOLUTION * np.abs(points).max(initial=0)
    points = points[..., (points.std(1) > smallest).any(0)]
    scenarios, count, dimensions = points.shape
    if not dimensions:
        return np.ones(scenarios)
    if count <= dimensions + 1:
        raise ValueError(
            f"{count} points are too few to test normality in {dimensions} dimensions: "
            f"at least {dimensions + 2} are needed"
        )
    singular = np.linalg.svd(points - points.mean(1, keepdims=True), compute_uv=False)
    varies = singular > smallest * np.sqrt(count)
    statistic = np.where(varies.all(1), henze_zirkler(points), 4.0 * count)
    null = _simulated(henze_zirkler, "standard_normal", (count, dimensions))
    return np.where(varies.any(1), _p_values(statistic, null), 1.0)


def not_unimodal(points: Array) -> Doubles:
    """P-value [S] of the dip test on the direction in which the points [S, K, D] vary most.

    The direction is the first principal component of each scenario. As in the paper, the null
    distribution is simulated with uniform samples. Among unimodal distributions the uniform one has
    the largest dip in the limit of many points, so the test is conservative for all others. The
    test can miss modes that differ in another direction. Points that are all equal have p = 1.

    The choice of the direction with the largest variance could increase false rejections. The tests
    of this module show that the rejection rate of Gaussian and uniform samples stays below the
    significance level.

    Raises:
        ValueError: a value that is not finite.
    """
    points = _doubles(points)
    smallest = RESOLUTION * np.abs(points).max(initial=0)
    projected = principal(points)
    statistic = np.where(projected.std(1) > smallest, dip(projected), 0.0)
    return _p_values(statistic, _simulated(dip, "random", (points.shape[1],)))


def henze_zirkler(points: Array) -> Doubles:
    """The statistic of Henze and Zirkler [S] of points [S, K, D], with their choice of β.

    It is the weighted squared distance between the characteristic functions of the normalized
    points and of N(0, I), in closed form. Larger means less Gaussian. It is undefined where the
    covariance is singular.
    """
    points = _doubles(points)
    scenarios, count, dimensions = points.shape
    square = 0.5 * ((2 * dimensions + 1) * count / 4) ** (2 / (dimensions + 4))  # β²
    statistic = np.empty(scenarios)
    for block in _blocks(scenarios, count * count):
        centred = points[block] - points[block].mean(1, keepdims=True)
        # √K times the left singular vectors are the points normalized by their covariance.
        normalized = np.linalg.svd(centred, full_matrices=False)[0] * np.sqrt(count)
        lengths = np.sum(normalized**2, -1)
        products = normalized @ normalized.transpose(0, 2, 1)
        pairs = np.exp(-square * (lengths[:, :, None] / 2 + lengths[:, None] / 2 - products))
        singles = np.exp(-square / (2 * (1 + square)) * lengths)
        statistic[block] = (
            pairs.sum((1, 2)) / count
            - 2 * (1 + square) ** (-dimensions / 2) * singles.sum(1)
            + count * (1 + 2 * square) ** (-dimensions / 2)
        )
    return statistic


def principal(points: Array) -> Doubles:
    """Points [S, K, D] projected on the direction of largest variance of each scenario: [S, K]."""
    points = _doubles(points)
    centred = points - points.mean(1, keepdims=True)
    direction = np.linalg.svd(centred, full_matrices=False)[2][:, :1]
    # Unlike the left singular vectors, this projection keeps equal points exactly equal.
    return np.asarray((centred * direction).sum(-1))


@cache
def _simulated(
    statistic: Callable[[Array], Doubles], distribution: str, shape: tuple[int, ...]
) -> Doubles:
    """The sorted statistic [SIMULATIONS] of samples of one shape from a distribution of NumPy."""
    seed = derive("portrait", statistic.__name__, *shape)
    sample = getattr(np.random.default_rng(seed), distribution)
    return np.sort(statistic(sample((SIMULATIONS, *shape))))


def _p_values(statistic: Doubles, null: Doubles) -> Doubles:
    """Share of the sorted null sample, with the statistic added, that is at least as large."""
    # The tolerance is for rounding: the distribution of the dip has an atom at 1 / 2K.
    at_least = len(null) - np.searchsorted(null, statistic - 1e-12)
    return (1 + at_least) / (1 + len(null))


def _blocks(scenarios: int, size: int) -> list[slice]:
    """Slices of scenarios; with `size` numbers a scenario, each slice has at most `BLOCK`."""
    step = max(1, BLOCK // size)
    return [slice(start, start + step) for start in range(0, scenarios, step)]


def _doubles(values: Array) -> Doubles:
    values = np.asarray(values, np.float64)
    if not np.isfinite(values).all():
        raise ValueError("tests of a distribution need points that are all finite")
    return values
