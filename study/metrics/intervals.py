"""95 % intervals by a hierarchical bootstrap over training seeds and scenarios.

All seeds are scored on the same scenarios: the two factors are crossed. A resample contains seeds
and scenarios, both sampled with replacement, and all its seeds share its scenarios (Davison and
Hinkley 1997, section 3.8; Owen 2007, "The pigeonhole bootstrap"). Intervals are percentiles.

With one seed, only the scenarios are resampled, and the interval does not include the variation of
training. With two or three seeds the interval is too narrow. State the number of seeds beside every
interval.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from study.common.arrays import Array, Doubles

RESAMPLES = 2000
"""Bootstrap resamples."""
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


def resampled_means(values: Array, resamples: int = RESAMPLES, seed: int = 0) -> Doubles:
    """Means of bootstrap resamples.

    Args:
        values: [seeds, S, ...]. Elements of the trailing axes, such as steps, are resampled
            together. A resample with an infinite value has an infinite mean.
        resamples: B, their number.
        seed: of the random numbers.

    Returns:
        [B, ...].
    """
    values = np.asarray(values, np.float64)
    seeds, scenarios, *rest = values.shape
    by_seed, by_scenario = _shares(seeds, scenarios, resamples, seed)
    flat = values.reshape(seeds, scenarios, -1)
    infinite = np.isinf(flat)
    total = np.zeros((resamples, flat.shape[2]))
    for weight, of_seed in zip(by_seed.T, np.where(infinite, 0.0, flat), strict=True):
        total += weight[:, None] * (by_scenario @ of_seed)
    for number, scenario, column in np.argwhere(infinite):
        included = (by_seed[:, number] > 0) & (by_scenario[:, scenario] > 0)
        total[included, column] += flat[number, scenario, column]
    return total.reshape(resamples, *rest)


@lru_cache(maxsize=4)
def _shares(seeds: int, scenarios: int, resamples: int, seed: int) -> tuple[Doubles, Doubles]:
    """The weight of each seed [B, seeds] and scenario [B, S] in each resample; rows sum to one."""
    generator = np.random.default_rng(seed)
    by_seed = generator.multinomial(seeds, np.full(seeds, 1 / seeds), resamples)
    by_scenario = generator.multinomial(scenarios, np.full(scenarios, 1 / scenarios), resamples)
    return by_seed / seeds, by_scenario / scenarios


def percentiles(means: Array, probability: float = PROBABILITY) -> tuple[Array, Array]:
    """The ends, each [...], of the central interval of bootstrap means [B, ...]."""
    ends = [(1 - probability) / 2, (1 + probability) / 2]
    # Interpolation between an infinite and a finite mean is not defined.
    if not np.isfinite(means).all():
        low, high = np.quantile(means, ends, axis=0, method="inverted_cdf")
        return low, high
    low, high = np.quantile(means, ends, axis=0)
    return low, high


def interval(
    values: Array, probability: float = PROBABILITY, resamples: int = RESAMPLES, seed: int = 0
) -> Interval:
    """The mean of values [seeds, S] and its interval; other arguments as of `resampled_means`."""
    low, high = percentiles(resampled_means(values, resamples, seed), probability)
    return Interval(float(np.mean(values)), float(low), float(high), *np.shape(values))


def difference(
    first: Array,
    second: Array,
    probability: float = PROBABILITY,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Interval:
    """The mean of `first` minus `second` and its interval, paired on seeds and scenarios.

    Args:
        first: [seeds, S].
        second: [seeds, S], on the same seeds and scenarios.
        probability: of the interval.
        resamples: of the bootstrap.
        seed: of the random numbers.
    """
    return interval(np.asarray(first) - np.asarray(second), probability, resamples, seed)
