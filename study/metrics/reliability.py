"""Reliability of forecast probabilities: Murphy's decomposition and the reliability curve.

Murphy (1973, "A new vector partition of the probability score") decomposes the mean Brier score:

    Brier score = reliability - resolution + uncertainty

Scenarios are grouped by their forecast probability, in ten bins of equal width. *Reliability* is
the mean squared difference of mean forecast and observed frequency within groups; 0 is best.
*Uncertainty* is the variance o (1 - o) of the outcome, the same for all forecasters. *Resolution*
measures how well the forecasts separate scenarios. It is the generalised resolution of Stephenson,
Coelho and Jolliffe (2008), which includes differences within a bin, so that the identity is exact.
Resolution is negative if these differences are noise.

**What is estimated.** Forecasts are shares of K samples, observations are shares of L rollouts, and
the S scenarios are a sample. The wanted terms are those for infinite K, L and S. Using the shares
in their place has three biases, each with its correction:

- The bins. A share falls into a high bin partly by chance, so a perfect forecaster looks
  overconfident. Here, sample x_sk is binned by the share of the other K - 1 samples of its
  scenario, of which it is independent.
- The square of a mean over the scenarios of a bin includes the square of its noise. Let
  d_s = x_sk - o_s, where o_s is the share of rollouts. For two different scenarios s and t of a
  bin, the expectation of d_s d_t is the square of the expectation of d. With n_b scenarios in bin
  b,

      reliability = mean over k of Σ_b (n_b / S) · mean over pairs s ≠ t in b of d_s d_t
      uncertainty = mean over pairs s ≠ t of o_s (1 - o_t)

  For forecasts without sampling noise and L = 1 these are the terms of Ferro and Fricker (2012, "A
  bias-corrected decomposition of the Brier score").
- The score. It is the fair one (`study.metrics.brier.brier_fair`). Resolution follows from the
  identity: reliability + uncertainty - fair Brier score.

All terms are unbiased, for bins by K - 1 samples. Each can be slightly negative.

**Non-finite forecasts.** If any sample is not finite, reliability is ∞ and resolution -∞. No finite
forecast has worse terms.
"""

from dataclasses import dataclass

import numpy as np

from study.common.arrays import Array, Doubles, Integers
from study.metrics.brier import brier_fair
from study.metrics.intervals import band

BINS = 10
"""Bins of forecast probability, of equal width."""


@dataclass(frozen=True)
class Decomposition:
    """Terms of a mean Brier score; NaN where there are fewer than two scenarios."""

    reliability: float
    """0 is best."""
    resolution: float
    """Higher is better: at most `uncertainty`; 0 for the base rate."""
    uncertainty: float

    @property
    def score(self) -> float:
        """The mean fair Brier score; ∞ if a sample is not finite."""
        return self.reliability - self.resolution + self.uncertainty


def decompose(
    forecast: Array, observed: Array, valid: Array | None = None, bins: int = BINS
) -> Decomposition:
    """The decomposition of the mean fair Brier score, unbiased in K, L and S (see the module).

    Args:
        forecast: [S, K] bool, K ≥ 2, whether the outcome happens in each sample.
        observed: [S, L] bool, whether the outcome happens in each rollout.
        valid: [S, K] bool, which samples are finite; all if None.
        bins: number of bins of equal width. A bin with one scenario is merged with its neighbour.
    """
    score = float(brier_fair(forecast, observed, valid).mean())
    scenarios, samples = np.shape(forecast)
    if scenarios < 2:
        return Decomposition(np.nan, np.nan, np.nan)
    frequency = np.asarray(observed, bool).mean(1)
    base, variance = frequency.mean(), frequency.var(ddof=1)
    uncertainty = float(base * (1 - base) + variance / scenarios)
    if valid is not None and not np.all(valid):
        return Decomposition(np.inf, -np.inf, uncertainty)
    sampled = np.asarray(forecast, np.float64)
    total = sampled.sum(1)
    reliability = float(
        np.mean(
            [
                _squared_bias(sample - frequency, group_of((total - sample) / (samples - 1), bins))
                for sample in sampled.T
            ]
        )
    )
    return Decomposition(reliability, reliability + uncertainty - score, uncertainty)


def _squared_bias(difference: Doubles, group: Integers) -> float:
    """Unbiased mean over scenarios [S] of the squared mean difference in their group.

    The sum of d_s d_t over pairs s ≠ t is (Σ d)² - Σ d². Each group has two scenarios or more.
    """
    count = np.bincount(group)
    total, squares = np.bincount(group, difference), np.bincount(group, difference**2)
    used = count > 0
    pairs = (total**2 - squares)[used] / (count - 1)[used]
    return float(pairs.sum() / len(difference))


def group_of(probability: Array, bins: int = BINS, smallest: int = 2) -> Integers:
    """The bin [S] of each probability [S]: `bins` of equal width, the last one closed.

    While any bin has fewer than `smallest` elements, the smallest bin is merged with the nearest
    bin that is not empty.
    """
    group = _bins(probability, bins)
    while True:
        count = np.bincount(group)
        used = np.flatnonzero(count)
        if len(used) < 2 or count[used].min() >= smallest:
            return group
        merged = used[count[used].argmin()]
        others = used[used != merged]
        group = np.where(group == merged, others[np.abs(others - merged).argmin()], group)


def _bins(probability: Array, bins: int) -> Integers:
    # Rounding can put a share such as 7/10 just below the edge of its bin.
    scaled = np.asarray(probability, np.float64) * bins + 1e-9
    return np.clip(scaled.astype(np.int64), 0, bins - 1)


@dataclass(frozen=True)
class Curve:
    """Points [P] of a reliability diagram, in the order of the forecast."""

    forecast: Doubles
    """Mean forecast of a bin."""
    observed: Doubles
    """Frequency of the outcome over all rollouts of the scenarios of a bin."""
    count: Integers
    """Number of forecasts in a bin."""
    low: Doubles
    """Lower end of the 95 % interval of `observed`."""
    high: Doubles
    """Upper end of the 95 % interval of `observed`."""


def reliability_curve(
    forecast_probability: Array,
    observed_probability: Array,
    bins: int = BINS,
    smallest: int = 10,
) -> Curve:
    """Mean forecast and observed frequency of each bin, with a 95 % interval of the frequency.

    Intervals are t intervals over scenarios, for the given training seeds. With few seeds,
    intervals over seeds too would fill the diagram. A frequency is a ratio of means, so they are
    intervals of its linear approximation, within [0, 1]. They are around the observed frequency and
    not around the diagonal (Bröcker and Smith 2007), because a diagram shows several models.

    Each forecast is binned by its own value, so the curve of a perfect forecaster with few samples
    is slightly too flat. `decompose` corrects this bias.

    Args:
        forecast_probability: [S], or [seeds, S].
        observed_probability: [S], share of the rollouts in which the outcome happens.
        bins: number of bins of equal width.
        smallest: a bin with fewer forecasts a seed, on average, is merged with its neighbour.
    """
    forecast = np.atleast_2d(np.asarray(forecast_probability, np.float64))
    observed = np.asarray(observed_probability, np.float64)
    group = group_of(forecast.ravel(), bins, smallest * len(forecast))
    used = np.unique(group)
    within = (group[:, None] == used).reshape(*forecast.shape, -1).astype(np.float64)
    count = within.sum((0, 1))
    successes = within * observed[:, None]
    mean = successes.sum((0, 1)) / count
    # Each scenario's contribution to the error of the frequency, to first order; its mean is zero.
    error = band((successes - mean * within).mean(0, keepdims=True) / within.mean((0, 1)))
    return Curve(
        (within * forecast[..., None]).sum((0, 1)) / count,
        mean,
        count.astype(np.int64),
        np.maximum(mean + error.low, 0),
        np.minimum(mean + error.high, 1),
    )
