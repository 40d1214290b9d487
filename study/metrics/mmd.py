"""Maximum mean discrepancy with a Gaussian kernel, for each scenario, step and state dimension.

Section IV-D of the paper: "each forecasted state dimension is compared with the corresponding
environmental observation at a temporal level". With k(x, y) = exp(-(x - y)² / 2h²), on states
standardised by the training data, and samples x_1 … x_K (forecast), y_1 … y_L (observed):

    unbiased MMD²   mean_{i≠j} k(x_i, x_j) + mean_{i≠j} k(y_i, y_j) - 2 mean_{ij} k(x_i, y_j)
    biased MMD      the root of the same with the diagonals i = j kept

(Gretton et al., "A kernel two-sample test", JMLR 13, 2012, equations 3 and 5.) The unbiased one
averages zero for equal distributions, so it may be negative; the biased one never is.

Scenario by scenario, step by step and dimension by dimension the samples are only numbers, so the
sums over pairs take linear time (`study.metrics.kernel_sums`), exact to 1e-9.

**Non-finite forecasts.** Every value that is not finite, or lies more than 1e15 bandwidths from
the observed, is taken as the same point at infinity: its kernel is 0 with every other value and 1
with its like. No finite forecast can score worse, and none is dropped.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from study.common.arrays import Array, Doubles
from study.metrics.kernel_sums import Gaps, gaps

Told = Callable[[float], None]

FLOOR = 0.1
"""Least bandwidth, in standard deviations of the training data: a smaller error does not matter."""

PAIRS = 16
"""Pairs of observed rollouts of each scenario that the median heuristic looks at."""

INFINITY = 1e15
"""Where the point at infinity is, in units of √2 bandwidths."""

FACTORS = (0.5, 1.0, 2.0)
"""Multiples of the bandwidth that show what hangs on it."""


def standard(scale: Array) -> Doubles:
    """The unit of each dimension [D]: `scale`, or 1 where a dimension never varied in training."""
    scale = np.asarray(scale, np.float64)
    return np.where(scale > 0, scale, 1.0)


def bandwidths(observed: Array, scale: Array, floor: float = FLOOR) -> Doubles:
    """Bandwidth h of each dimension [D], in standard deviations of the training data.

    The median heuristic (Gretton et al. 2012, section 8): the median distance between two observed
    rollouts [S, L, T, D] of the same scenario at the same step, over all scenarios and steps. Ties
    say nothing about scale (a ball that nothing has touched yet) and are left out. Forecasts play
    no part, so one bandwidth serves all models.

    Args:
        observed: [S, L, T, D], L ≥ 2.
        scale: [D], standard deviations of the training data.
        floor: least bandwidth, also that of a dimension in which all rollouts agree.
    """
    count = min(observed.shape[1] // 2, PAIRS)
    if count < 1:
        raise ValueError("a bandwidth needs at least two observed rollouts a scenario")
    pairs = observed[:, : 2 * count].astype(np.float64)
    distance = np.abs(pairs[:, 0::2] - pairs[:, 1::2]) / standard(scale)
    medians = [
        np.median(apart) if (apart := column[column > 0]).size else 0.0
        for column in distance.reshape(-1, distance.shape[-1]).T
    ]
    return np.maximum(medians, floor)


@dataclass(frozen=True)
class Discrepancy:
    """How far forecasts are from observed rollouts; for `mmd`, both [S, T, D]."""

    squared: Doubles
    """Unbiased MMD²; averages zero for equal distributions, may be negative."""
    biased: Doubles
    """Biased MMD, the root of the V-statistic; never negative, and above zero by chance."""


def mmd(
    forecast: Array,
    observed: Array,
    scale: Array,
    bandwidth: Array,
    progress: Told | None = None,
) -> Discrepancy:
    """Discrepancy between forecasts and observed rollouts of the same scenario.

    Args:
        forecast: [S, K, T, D], physical units, K ≥ 2. Non-finite values: see the module.
        observed: [S, L, T, D], physical units, L ≥ 2, finite.
        scale: [D], standard deviations of the training data.
        bandwidth: [D], in units of `scale`.
        progress: told the share that is done, 0 to 1.

    Raises:
        ValueError: fewer than two samples on a side, or a non-finite observed value.
    """
    found = _gaps(forecast, observed, scale, bandwidth, (1.0,), progress)
    parts = Gaps(found.among_x[0], found.among_y[0], found.across[0])
    return discrepancy(parts, forecast.shape[1], observed.shape[1])


def sensitivity(
    forecast: Array,
    observed: Array,
    scale: Array,
    bandwidth: Array,
    factors: Sequence[float] = FACTORS,
    progress: Told | None = None,
) -> tuple[Discrepancy, ...]:
    """`mmd` for several multiples of the bandwidth, three of them in the time of two.

    Arguments and errors are those of `mmd`.
    """
    found = _gaps(forecast, observed, scale, bandwidth, factors, progress)
    each = zip(found.among_x, found.among_y, found.across, strict=True)
    return tuple(discrepancy(Gaps(*p), forecast.shape[1], observed.shape[1]) for p in each)


def pooled(
    forecast: Array,
    observed: Array,
    scale: Array,
    bandwidth: Array,
    progress: Told | None = None,
) -> Discrepancy:
    """`mmd` [T, D] of the samples of all scenarios thrown together, S·K against S·L numbers.

    The other reading of the paper. It compares how states are spread over scenarios, so a forecast
    that takes one scenario for another goes unpunished. The bandwidth is that of `mmd`: the two
    readings then differ in what is compared, and not in the kernel.

    Samples that share a scenario are more alike than others, and both sides share the scenarios.
    The textbook estimator leaves out only the pairs i = j, so for equal distributions it averages
    -(a - b) (1 - 1/S) (1/(SK - 1) + 1/(SL - 1)), a and b the mean kernel within a scenario and
    across scenarios: nothing at the paper's scale, but not zero at a small one.

    Arguments and errors are those of `mmd`.
    """
    check(forecast, observed)
    scenarios, samples, steps, dimensions = forecast.shape
    rollouts = observed.shape[1]
    found = np.empty((3, steps, dimensions))
    for step in range(steps):
        x = forecast[:, :, step].reshape(scenarios * samples, dimensions)
        y = observed[:, :, step].reshape(scenarios * rollouts, dimensions)
        parts = gaps(*standardise(x, y, scale, bandwidth))
        found[:, step] = parts.among_x[0], parts.among_y[0], parts.across[0]
        if progress is not None:
            progress((step + 1) / steps)
    return discrepancy(Gaps(*found), scenarios * samples, scenarios * rollouts)


def shifted(forecast: Array, observed: Array, by: float) -> Array:
    """Forecasts moved by so many standard deviations of the scenario's observed rollouts.

    Their MMD² is the ruler: what it means to be that far off, per scenario, step and dimension.

    Args:
        forecast: [S, K, T, D].
        observed: [S, L, T, D], the same units.
        by: standard deviations.
    """
    spread = observed.std(axis=1, keepdims=True, dtype=np.float64)
    return np.asarray((forecast + by * spread).astype(forecast.dtype))


def kernel_score(forecast: Array, observation: Array, scale: Array, bandwidth: Array) -> float:
    """Fair Gaussian kernel score of ensembles against one observation each; lower is better.

    mean_{i≠j} k(x_i, x_j) - 2 mean_i k(x_i, y), averaged over N, T and D: unbiased MMD² against
    the single observation, less the constant k(y, y) = 1. A proper score: its expectation is least
    for the true distribution, whatever K. (Gneiting and Raftery, JASA 102, 2007, section 5.)

    Args:
        forecast: [N, K, T, D], physical units, K ≥ 2. Non-finite values: see the module.
        observation: [N, T, D], physical units, finite.
        scale: [D], standard deviations of the training data.
        bandwidth: [D], in units of `scale`.
    """
    found = _gaps(forecast, observation[:, None], scale, bandwidth, (1.0,), least=1)
    samples = forecast.shape[1]
    among = 1 - found.among_x * samples / (samples - 1)
    return float(np.mean(among - 2 * (1 - found.across)))


def check(forecast: Array, observed: Array, least: int = 2) -> None:
    """Refuse what has no MMD²: too few samples, or observed values that are not finite."""
    if forecast.shape[1] < 2 or observed.shape[1] < least:
        raise ValueError("MMD² needs at least two forecasts and two observed rollouts a scenario")
    if not np.isfinite(observed).all():
        raise ValueError("an observed trajectory has values that are not finite")


def discrepancy(parts: Gaps, samples: int, rollouts: int) -> Discrepancy:
    """Both estimators from the means of 1 - k over all pairs of K samples and L rollouts."""
    biased = 2 * parts.across - parts.among_x - parts.among_y
    squared = biased - parts.among_x / (samples - 1) - parts.among_y / (rollouts - 1)
    # The V-statistic is a squared norm: only rounding can take it below zero.
    return Discrepancy(squared, np.sqrt(np.maximum(biased, 0)))


def standardise(
    samples: Array, rollouts: Array, scale: Array, bandwidth: Array
) -> tuple[Doubles, Doubles]:
    """Both [..., D] in units of √2 bandwidths, so that k(x, y) = exp(-(x - y)²).

    Measured from the first rollout; what is not finite is at `INFINITY`.
    """
    unit = np.sqrt(2) * standard(scale) * bandwidth
    origin = rollouts[0].astype(np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        x, y = ((each - origin) / unit for each in (samples, rollouts))
        x[~(np.abs(x) < INFINITY)] = INFINITY
    return x, y


def _gaps(
    forecast: Array,
    observed: Array,
    scale: Array,
    bandwidth: Array,
    factors: Sequence[float],
    progress: Told | None = None,
    least: int = 2,
) -> Gaps:
    """Means of 1 - k over all pairs of each scenario, [F, S, T, D]."""
    check(forecast, observed, least)
    scenarios, _, steps, dimensions = observed.shape
    found = np.empty((3, len(factors), scenarios, steps, dimensions))
    for scenario, (samples, rollouts) in enumerate(zip(forecast, observed, strict=True)):
        x, y = standardise(samples, rollouts, scale, bandwidth)
        parts = gaps(x.reshape(len(x), -1), y.reshape(len(y), -1), factors)
        for kind, part in enumerate((parts.among_x, parts.among_y, parts.across)):
            found[kind, :, scenario] = part.reshape(-1, steps, dimensions)
        if progress is not None:
            progress((scenario + 1) / scenarios)
    return Gaps(*found)
