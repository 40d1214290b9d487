"""95 % intervals by a hierarchical bootstrap over training seeds and scenarios.

Every seed is scored on the same scenarios, so the two are crossed: a resample draws seeds, and
once for all of them scenarios, with replacement (Davison and Hinkley 1997, section 3.8; Owen 2007,
"The pigeonhole bootstrap"). Intervals are percentiles. With one seed only the scenarios are
resampled, and the interval says nothing of how much training varies; with two or three it is too
narrow. So the number of seeds belongs beside every interval.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from study.common.arrays import Array, Doubles

RESAMPLES = 2000
LEVEL = 0.95


@dataclass(frozen=True)
class Interval:
    """An estimate, the ends of its interval, and what it rests on."""

    estimate: float
    low: float
    high: float
    seeds: int
    scenarios: int


def resampled_means(values: Array, resamples: int = RESAMPLES, seed: int = 0) -> Doubles:
    """Means of `resamples` bootstrap samples: [B, ...] from values [seeds, S, ...].

    What follows the first two axes (steps, say) is resampled together. A resample that draws an
    infinite value has an infinite mean, and one that draws none has not.
    """
    values = np.asarray(values, np.float64)
    seeds, scenarios, *rest = values.shape
    by_seed, by_scenario = _shares(seeds, scenarios, resamples, seed)
    flat = values.reshape(seeds, scenarios, -1)
    infinite = np.isinf(flat)
    total = np.zeros((resamples, flat.shape[2]))
    for weight, of_seed in zip(by_seed.T, np.where(infinite, 0.0, flat), strict=True):
        total += weight[:, None] * (by_scenario @ of_seed)
    for at_seed, scenario, place in np.argwhere(infinite):
        drawn = (by_seed[:, at_seed] > 0) & (by_scenario[:, scenario] > 0)
        total[drawn, place] += flat[at_seed, scenario, place]
    return total.reshape(resamples, *rest)


@lru_cache(maxsize=4)
def _shares(seeds: int, scenarios: int, resamples: int, seed: int) -> tuple[Doubles, Doubles]:
    """How often each resample draws each seed [B, seeds] and scenario [B, S]; rows sum to one."""
    generator = np.random.default_rng(seed)
    by_seed = generator.multinomial(seeds, np.full(seeds, 1 / seeds), resamples)
    by_scenario = generator.multinomial(scenarios, np.full(scenarios, 1 / scenarios), resamples)
    return by_seed / seeds, by_scenario / scenarios


def percentiles(draws: Array, level: float = LEVEL) -> tuple[Array, Array]:
    """The ends of the central interval of draws [B, ...], each [...]."""
    ends = [(1 - level) / 2, (1 + level) / 2]
    # Between an infinite draw and its neighbour nothing can be interpolated.
    if not np.isfinite(draws).all():
        low, high = np.quantile(draws, ends, axis=0, method="inverted_cdf")
        return low, high
    low, high = np.quantile(draws, ends, axis=0)
    return low, high


def interval(
    values: Array, level: float = LEVEL, resamples: int = RESAMPLES, seed: int = 0
) -> Interval:
    """The mean of values [seeds, S] and its interval."""
    low, high = percentiles(resampled_means(values, resamples, seed), level)
    return Interval(float(np.mean(values)), float(low), float(high), *np.shape(values))


def difference(
    first: Array,
    second: Array,
    paired: bool = True,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Interval:
    """The mean of `first` less that of `second`, and its interval.

    Args:
        first: [seeds, S].
        second: [seeds, S], on the same seeds and scenarios if paired.
        paired: subtract seed by seed and scenario by scenario before resampling; otherwise the two
            are resampled on their own, and the counts given are the smaller ones.
    """
    if paired:
        return interval(np.asarray(first) - np.asarray(second), level, resamples, seed)
    draws = resampled_means(first, resamples, seed) - resampled_means(second, resamples, seed + 1)
    low, high = percentiles(draws, level)
    counts = np.minimum(np.shape(first), np.shape(second))
    estimate = float(np.mean(first) - np.mean(second))
    return Interval(estimate, float(low), float(high), int(counts[0]), int(counts[1]))
