"""95 % intervals of mean scores over training seeds and scenarios, for few seeds.

All seeds are scored on the same scenarios: the two factors are crossed. A score z of seed r and
scenario s is a sum of independent effects of the seed, the scenario and both, z_rs = μ + a_r + b_s
+ e_rs. The mean over R seeds and S scenarios has the variance

    (σ_a² + σ_e² / S) / R  +  σ_b² / S

The variance of the seeds' means, divided by R, estimates the first term, with R - 1 degrees of
freedom. The variance of the scenarios' means, divided by S, estimates the second term and σ_e² /
RS, with S - 1 degrees of freedom. With t the quantile of Student's distribution for each, the half
width of the interval is

    √( t²(R - 1) · var(seed means) / R  +  t²(S - 1) · var(scenario means) / S )

This is the interval of Banerjee (1960, "Approximate confidence interval for linear functions of
means of k populations when the population variances are not equal", Sankhyā 22, 357-358). For
normal effects its coverage is at least the nominal one, for any R, S and variances: the coverage
given the two estimated variances is a concave function of their weighted sum, so by Jensen's
inequality it is at least the weighted mean of the coverages of two t intervals. A bootstrap over
seeds and scenarios, and a t interval with Satterthwaite's degrees of freedom, are too narrow if two
seeds are alike by chance. The tests show all three with the variances of the paper's study.

With one seed the interval is over the scenarios alone, and does not include the variation of
training: state the number of seeds beside every interval (`basis` does). With one scenario it is
over the seeds alone. With one of each there is no interval: its ends are infinite.

A population with an infinite score has an infinite mean. So both ends of the interval are infinite
if a score is.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import stats

from study.common.arrays import Array, Doubles

PROBABILITY = 0.95
"""Probability of an interval."""


@dataclass(frozen=True)
class Interval:
    """An estimate, the ends of its interval, and the numbers of seeds and scenarios behind it."""

    estimate: float
    low: float
    high: float
    seeds: int
    scenarios: int


@dataclass(frozen=True)
class Band:
    """Estimates and the ends of their intervals, of any common shape."""

    estimate: Doubles
    low: Doubles
    high: Doubles


def band(values: Array, probability: float = PROBABILITY) -> Band:
    """Means and their intervals [...], each for itself, of values [seeds, S, ...]."""
    return sum_of_means([values], probability)


def interval(values: Array, probability: float = PROBABILITY) -> Interval:
    """The mean of values [seeds, S] and its interval."""
    found = band(values, probability)
    return Interval(float(found.estimate), float(found.low), float(found.high), *np.shape(values))


def difference(first: Array, second: Array, probability: float = PROBABILITY) -> Interval:
    """The mean of `first` minus `second` and its interval, paired on seeds and scenarios.

    Args:
        first: [seeds, S].
        second: [seeds, S], on the same seeds and scenarios.
        probability: of the interval.
    """
    with np.errstate(invalid="ignore"):
        return interval(np.asarray(first) - np.asarray(second), probability)


def sum_of_means(parts: Sequence[Array], probability: float = PROBABILITY) -> Band:
    """The sum of the means of independent parts, such as environments, and its interval.

    Args:
        parts: each [seeds, S, ...], with its own seeds and scenarios.
        probability: of the interval.
    """
    parts = [np.asarray(part, np.float64) for part in parts]
    with np.errstate(invalid="ignore"):
        estimate = np.asarray(sum(part.mean((0, 1)) for part in parts))
        squared = np.asarray(sum(_squared_half_width(part, probability) for part in parts))
        half = np.where(np.isfinite(estimate), np.sqrt(squared), 0.0)
        low, high = estimate - half, estimate + half
    undefined = np.isnan(estimate)
    return Band(estimate, np.where(undefined, -np.inf, low), np.where(undefined, np.inf, high))


def training_seeds(counts: Collection[int]) -> str:
    """The numbers of training seeds in words: `1 training seed`, `1 to 5 training seeds`.

    Args:
        counts: of the intervals of a table or figure; empty if no model was trained.
    """
    numbers = " to ".join(map(str, sorted({min(counts), max(counts)}))) if counts else "no"
    return f"{numbers} training seed{'' if numbers == '1' else 's'}"


def basis(seeds: Collection[int]) -> str:
    """What an interval is over, for captions.

    Args:
        seeds: the distinct numbers of training seeds of the intervals of a table or figure.
    """
    if set(seeds) == {1}:
        return "95 % t intervals over scenarios only, without the variation of training"
    alone = "; with 1 seed over scenarios only" if 1 in seeds else ""
    return f"95 % t intervals over training seeds and scenarios{alone}"


def _squared_half_width(values: Doubles, probability: float) -> Doubles:
    """The squared half width [...] of the interval of the mean of values [seeds, S, ...]."""
    sizes = values.shape[:2]
    if max(sizes) < 2:
        return np.full(values.shape[2:], np.inf)
    total = np.zeros(values.shape[2:])
    for axis, size in enumerate(sizes):
        if size > 1:
            means = values.mean(1 - axis)
            total += _quantile(size - 1, probability) ** 2 * means.var(0, ddof=1) / size
    return total


@lru_cache
def _quantile(degrees: int, probability: float) -> float:
    """The two-sided quantile of Student's t distribution."""
    return float(stats.t.ppf((1 + probability) / 2, degrees))
