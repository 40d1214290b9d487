"""Whether forecast probabilities mean what they say: Murphy's decomposition, and the curve.

Murphy (1973, "A new vector partition of the probability score") splits the mean Brier score:

    Brier score = reliability - resolution + uncertainty

With the scenarios grouped by what was forecast (ten bins of equal width), reliability is the mean
squared difference of mean forecast and frequency within groups, 0 for a forecaster whose 30 % come
true 30 times in a hundred; uncertainty is the variance o (1 - o) of the outcome, which no
forecaster changes; and resolution is what the forecast knows of the differences between scenarios.
It is the *generalised* resolution of Stephenson, Coelho and Jolliffe (2008): forecasts that differ
within a bin count, so that the identity is exact. It is less than 0 if these differences are noise.

**What is estimated.** Forecasts are shares of K samples, observations shares of L rollouts, of S
scenarios drawn from many. The terms wanted are those of the forecaster (K, L and S infinite) whose
probability is π_s where the true one is q_s. Plugging shares in is biased three ways:

- the bins: a share falls into a high bin partly by luck, so a perfect forecaster looks too
  confident. The excess p (1 - p) / K that shares cost lies between reliability and resolution, all
  of it in the one if every π is the same, nearly none if they differ much, so no term of that
  form corrects reliability. Here a sample is never binned by itself: sample x_sk goes into the
  bin b of the share of the other K - 1, of which it is independent;
- the square of a mean over the n scenarios of a bin: its noise, of samples, rollouts and the
  scenarios drawn, is squared too. With d_s = x_sk - o_s, o_s the share of rollouts, the expectation
  of d_s d_t is the square of that of d in the bin for any *two different* scenarios s and t, so

      reliability = mean over k of Σ_b (n_b / S) · mean over pairs s ≠ t in b of d_s d_t
      uncertainty = mean over pairs s ≠ t of o_s (1 - o_t)

  For forecasts without sampling noise and L = 1 these are the terms of Ferro and Fricker (2012, "A
  bias-corrected decomposition of the Brier score");
- the score: it is the fair one, see `study.metrics.brier.brier_fair`. Resolution is what the
  identity leaves: reliability + uncertainty - fair Brier score.

Each is unbiased, with bins formed from K - 1 samples, so any can come out slightly below 0.
"""

from dataclasses import dataclass

import numpy as np

from study.common.arrays import Array, Doubles, Integers
from study.metrics.brier import brier_fair
from study.metrics.intervals import RESAMPLES, percentiles, resampled_means

BINS = 10


@dataclass(frozen=True)
class Decomposition:
    """Terms of a mean Brier score; NaN where there are fewer than two scenarios."""

    reliability: float
    """0 is best."""
    resolution: float
    """`uncertainty` is best, 0 is that of the base rate."""
    uncertainty: float

    @property
    def score(self) -> float:
        """The mean Brier score that was split."""
        return self.reliability - self.resolution + self.uncertainty


def murphy(probability: Array, frequency: Array, bins: int = BINS) -> Decomposition:
    """Murphy's decomposition of the plain Brier score, without any correction.

    Args:
        probability: [S], what was forecast.
        frequency: [S], the share of the rollouts of the scenario in which it happened.
        bins: of equal width, in which forecasts are grouped.
    """
    probability, frequency = np.asarray(probability), np.asarray(frequency)
    group = _bins(probability, bins)
    count = np.maximum(np.bincount(group), 1)
    means = np.bincount(group, probability - frequency) / count
    reliability, base = float((means[group] ** 2).mean()), float(frequency.mean())
    score = np.mean(frequency * (1 - probability) ** 2 + (1 - frequency) * probability**2)
    uncertainty = base * (1 - base)
    return Decomposition(reliability, reliability + uncertainty - float(score), uncertainty)


def decompose(
    forecast: Array, observed: Array, valid: Array | None = None, bins: int = BINS
) -> Decomposition:
    """The decomposition of the mean fair Brier score, unbiased in K, L and S (see the module).

    A sample that is not finite forecasts neither: as 1/2 it takes part in the bins and
    differences, and what `brier_fair` charges for it beyond that is added to the reliability.

    Args:
        forecast: [S, K] bool, whether it happens in each sample, K ≥ 2.
        observed: [S, L] bool, whether it did in each rollout.
        valid: [S, K] bool, which samples are finite throughout; all if None.
        bins: of equal width; one with a single scenario is joined to its neighbour.
    """
    score = float(brier_fair(forecast, observed, valid).mean())
    scenarios, samples = np.shape(forecast)
    if scenarios < 2:
        return Decomposition(np.nan, np.nan, np.nan)
    frequency = np.asarray(observed, bool).mean(1)
    promise = np.asarray(forecast, np.float64)
    if valid is not None:
        promise = np.where(valid, promise, 0.5)
    total = promise.sum(1)
    reliability = float(
        np.mean(
            [
                _squared_bias(sample - frequency, group_of((total - sample) / (samples - 1), bins))
                for sample in promise.T
            ]
        )
    )
    base, spread = frequency.mean(), frequency.var(ddof=1)
    uncertainty = float(base * (1 - base) + spread / scenarios)
    # Of halves for what is not finite; the same as `score` if everything is.
    noise = promise.var(1, ddof=1) / samples
    error = (promise.mean(1) - frequency) ** 2 + frequency * (1 - frequency)
    of_halves = float((error - noise).mean())
    return Decomposition(
        reliability + score - of_halves, reliability + uncertainty - of_halves, uncertainty
    )


def _squared_bias(difference: Doubles, group: Integers) -> float:
    """Mean over scenarios [S] of the squared mean difference in their group, without bias.

    Σ over pairs s ≠ t of d_s d_t is (Σ d)² - Σ d²; each group holds two scenarios or more.
    """
    count = np.bincount(group)
    total, squares = np.bincount(group, difference), np.bincount(group, difference**2)
    held = count > 0
    pairs = (total**2 - squares)[held] / (count - 1)[held]
    return float(pairs.sum() / len(difference))


def group_of(probability: Array, bins: int = BINS, least: int = 2) -> Integers:
    """The bin [S] of each probability [S]: `bins` of equal width, the last one closed.

    As long as one holds fewer than `least`, the smallest is joined to the nearest that holds any.
    """
    group = _bins(probability, bins)
    while True:
        count = np.bincount(group)
        held = np.flatnonzero(count)
        if len(held) < 2 or count[held].min() >= least:
            return group
        smallest = held[count[held].argmin()]
        others = held[held != smallest]
        group = np.where(group == smallest, others[np.abs(others - smallest).argmin()], group)


def _bins(probability: Array, bins: int) -> Integers:
    # A share such as 7/10 may lie just below the edge at which it belongs.
    scaled = np.asarray(probability, np.float64) * bins + 1e-9
    return np.clip(scaled.astype(np.int64), 0, bins - 1)


@dataclass(frozen=True)
class Curve:
    """Points [P] of a reliability diagram, by rising forecast."""

    forecast: Doubles
    """The mean of the forecasts of a bin."""
    observed: Doubles
    """How often it happened, over the scenarios of the bin and all their rollouts."""
    count: Integers
    """How many forecasts the bin holds."""
    low: Doubles
    """Lower end of the 95 % interval of `observed`."""
    high: Doubles
    """Upper end."""


def reliability_curve(
    forecast_probability: Array,
    observed_probability: Array,
    bins: int = BINS,
    least: int = 10,
    resamples: int = RESAMPLES,
) -> Curve:
    """Mean forecast and observed frequency of each bin, with a 95 % interval of the frequency.

    Intervals are by a bootstrap over scenarios, and over training seeds if there are several:
    rollouts of one scenario are not independent of each other as evidence of calibration, and
    counting each as one would make intervals far too narrow. They are of the frequency rather than
    bars on the diagonal (Bröcker and Smith 2007), since a diagram shows several models: each keeps
    its bars, and one that misses the diagonal is not reliable.

    Forecasts are binned by themselves, so shares of few samples make even the best forecaster look
    slightly too confident; see the module, and `decompose` for a number without this.

    Args:
        forecast_probability: [S], or [seeds, S].
        observed_probability: [S], the share of the rollouts in which it happened.
        bins: of equal width.
        least: fewest forecasts of a seed in a bin, on average; one with fewer is joined to its
            neighbour, since a bootstrap of a handful gives no interval to trust.
        resamples: of the bootstrap.
    """
    forecast = np.atleast_2d(np.asarray(forecast_probability, np.float64))
    observed = np.asarray(observed_probability, np.float64)
    group = group_of(forecast.ravel(), bins, least * len(forecast))
    held = np.unique(group)
    within = (group[:, None] == held).reshape(*forecast.shape, -1).astype(np.float64)
    count = within.sum((0, 1))
    hits = within * observed[:, None]
    draws = resampled_means(np.concatenate([hits, within], axis=-1), resamples)
    happened, drawn = np.split(draws, 2, axis=-1)
    # A bin that a resample does not touch has no frequency there: its own mean stands in.
    mean = hits.sum((0, 1)) / count
    frequency = np.where(drawn > 0, happened / np.where(drawn > 0, drawn, 1), mean)
    low, high = percentiles(frequency)
    return Curve(
        (within * forecast[..., None]).sum((0, 1)) / count, mean, count.astype(np.int64), low, high
    )
