"""Maximum mean discrepancy with a Gaussian kernel, for each scenario, step and state dimension.

Section III-D of the paper: "each forecasted state dimension is compared with the corresponding
environmental observation at a temporal level". States are in standard deviations of the training
data. The kernel is k(x, y) = exp(-(x - y)² / 2h²). The forecast samples are x_1 … x_K, the observed
rollouts y_1 … y_L:

    unbiased MMD²   mean_{i≠j} k(x_i, x_j) + mean_{i≠j} k(y_i, y_j) - 2 mean_{ij} k(x_i, y_j)
    biased MMD      the square root of the same, with the diagonals i = j included

See Gretton et al., "A kernel two-sample test", JMLR 13, 2012, equations 3 and 5. The unbiased
estimate has mean zero for equal distributions and can be negative. The biased one cannot.

The samples of one scenario, step and dimension are scalars. `study.metrics.kernel_sums` therefore
computes the sums over pairs in linear time, exact to 1e-9.

**One observed rollout** (L = 1), as of a recorded system. The second mean does not exist and is
left out. The unbiased estimate is then 1 plus `kernel_score`: a proper score, whose lowest expected
value is not zero. Differences between forecasters keep their meaning.

**Non-finite forecasts.** A value that is not finite, or lies more than 1e15 bandwidths from the
observed values, has the kernel 1 with every forecast and 0 with every observed value. These are the
bounds of a kernel, so no finite values in its place score worse. No sample is dropped.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from study.common.arrays import Array, Doubles
from study.metrics.kernel_sums import Gaps, gaps

OnProgress = Callable[[float], None]
"""Called with the fraction that is done, from 0 to 1."""

FLOOR = 0.1
"""Smallest bandwidth, in standard deviations of the training data; smaller errors do not matter."""

PAIRS = 16
"""Pairs of observed rollouts of each scenario that the median heuristic uses."""

INFINITY = 1e15
"""Position of values that are not finite, in units of √2 bandwidths: far from all others."""

FACTORS = (0.5, 1.0, 2.0)
"""Multiples of the bandwidth at which `sensitivity` evaluates MMD."""


def nonzero_scale(scale: Array) -> Doubles:
    """`scale` [D], with 1 for each dimension that never varied in training."""
    scale = np.asarray(scale, np.float64)
    return np.where(scale > 0, scale, 1.0)


def bandwidths(observed: Array, scale: Array, floor: float = FLOOR) -> Doubles:
    """Bandwidth h of each dimension, by the median heuristic (Gretton et al. 2012, section 8).

    The heuristic takes the median distance between two observed rollouts of the same scenario at
    the same step, over all scenarios and steps. Distances of zero are left out: a ball that nothing
    has touched yet carries no information about scale. The bandwidth does not depend on forecasts,
    so all models share it.

    Args:
        observed: [S, L, T, D], L ≥ 2, physical units.
        scale: [D], standard deviations of the training data.
        floor: smallest bandwidth. A dimension in which all rollouts agree has this one.

    Returns:
        [D], in units of `scale`.

    Raises:
        ValueError: fewer than two observed rollouts a scenario.
    """
    count = min(observed.shape[1] // 2, PAIRS)
    if count < 1:
        raise ValueError(
            f"a bandwidth needs at least two observed rollouts a scenario, not {observed.shape[1]}"
        )
    pairs = observed[:, : 2 * count].astype(np.float64)
    distance = np.abs(pairs[:, 0::2] - pairs[:, 1::2]) / nonzero_scale(scale)
    medians = [
        np.median(apart) if (apart := column[column > 0]).size else 0.0
        for column in distance.reshape(-1, distance.shape[-1]).T
    ]
    return np.maximum(medians, floor)


@dataclass(frozen=True)
class Discrepancy:
    """Both estimates of MMD between forecasts and observed rollouts; for `mmd`, [S, T, D]."""

    squared: Doubles
    """Unbiased MMD²: mean zero for equal distributions, can be negative."""
    biased: Doubles
    """Biased MMD, the square root of the V-statistic: never negative, positive by chance."""


def mmd(
    forecast: Array,
    observed: Array,
    scale: Array,
    bandwidth: Array,
    progress: OnProgress | None = None,
) -> Discrepancy:
    """MMD between forecasts and observed rollouts of the same scenario.

    Args:
        forecast: [S, K, T, D], physical units, K ≥ 2. Non-finite values: see the module.
        observed: [S, L, T, D], physical units, L ≥ 2, finite.
        scale: [D], standard deviations of the training data.
        bandwidth: [D], in units of `scale`.
        progress: called with the fraction that is done.

    Returns:
        The discrepancy [S, T, D].

    Raises:
        ValueError: fewer than two samples on a side, or a non-finite observed value.
    """
    means = _gaps(forecast, observed, scale, bandwidth, (1.0,), progress)
    parts = Gaps(means.among_x[0], means.among_y[0], means.across[0])
    return discrepancy(parts, forecast.shape[1], observed.shape[1])


def sensitivity(
    forecast: Array,
    observed: Array,
    scale: Array,
    bandwidth: Array,
    factors: Sequence[float] = FACTORS,
    progress: OnProgress | None = None,
) -> tuple[Discrepancy, ...]:
    """`mmd` at each of `factors` times the bandwidth; three factors take the time of two.

    Arguments and errors are those of `mmd`.
    """
    means = _gaps(forecast, observed, scale, bandwidth, factors, progress)
    by_factor = zip(means.among_x, means.among_y, means.across, strict=True)
    return tuple(
        discrepancy(Gaps(*parts), forecast.shape[1], observed.shape[1]) for parts in by_factor
    )


def pooled(
    forecast: Array,
    observed: Array,
    scale: Array,
    bandwidth: Array,
    progress: OnProgress | None = None,
) -> Discrepancy:
    """MMD [T, D] of the samples of all scenarios pooled: S·K forecasts against S·L rollouts.

    This is the other reading of the paper. It compares the distribution of states over scenarios,
    so it does not penalise a forecast for mistaking one scenario for another. The bandwidth is that
    of `mmd`, so the two readings differ in the samples and not in the kernel.

    Samples of one scenario are more alike than others, and both sides share the scenarios. The
    standard estimator leaves out the pairs i = j only. For equal distributions its mean is
    therefore -(a - b) (1 - 1/S) (1/(SK - 1) + 1/(SL - 1)), where a and b are the mean kernel within
    a scenario and across scenarios. This bias is negligible for hundreds of scenarios.

    Arguments and errors are those of `mmd`.
    """
    check_inputs(forecast, observed)
    scenarios, samples, steps, dimensions = forecast.shape
    rollouts = observed.shape[1]
    means = np.empty((3, steps, dimensions))
    for step in range(steps):
        x = forecast[:, :, step].reshape(scenarios * samples, dimensions)
        y = observed[:, :, step].reshape(scenarios * rollouts, dimensions)
        x, y = normalize(x, y, scale, bandwidth)
        parts = gaps(x, y)
        among_x = at_worst(parts.among_x[0], (x == INFINITY).mean(0))
        means[:, step] = among_x, parts.among_y[0], parts.across[0]
        if progress is not None:
            progress((step + 1) / steps)
    return discrepancy(Gaps(*means), scenarios * samples, scenarios * rollouts)


def shifted(forecast: Array, observed: Array, by: float) -> Array:
    """Forecasts [S, K, T, D] shifted by `by` standard deviations of the observed rollouts.

    The MMD² of shifted oracle forecasts is the *reference shift*: it shows which MMD² an error of
    known size has.

    Args:
        forecast: [S, K, T, D].
        observed: [S, L, T, D], in the same units. The standard deviation is that of each scenario,
            step and dimension.
        by: the shift, in standard deviations.
    """
    deviation = observed.std(axis=1, keepdims=True, dtype=np.float64)
    return np.asarray((forecast + by * deviation).astype(forecast.dtype))


def kernel_score(forecast: Array, observation: Array, scale: Array, bandwidth: Array) -> float:
    """Fair Gaussian kernel score of samples against one observation each; lower is better.

    The score is mean_{i≠j} k(x_i, x_j) - 2 mean_i k(x_i, y), averaged over N, T and D. It equals
    unbiased MMD² against the single observation, less the constant k(y, y) = 1. It is proper: the
    true distribution has the lowest expected score, for any K. See Gneiting and Raftery, JASA 102,
    2007, section 5.

    Args:
        forecast: [N, K, T, D], physical units, K ≥ 2. Non-finite values: see the module.
        observation: [N, T, D], physical units, finite.
        scale: [D], standard deviations of the training data.
        bandwidth: [D], in units of `scale`.
    """
    means = _gaps(forecast, observation[:, None], scale, bandwidth, (1.0,))
    samples = forecast.shape[1]
    among = 1 - means.among_x * samples / (samples - 1)
    return float(np.mean(among - 2 * (1 - means.across)))


def check_inputs(forecast: Array, observed: Array) -> None:
    """Raise ValueError for too few samples or rollouts, or a non-finite observed value."""
    samples, rollouts = forecast.shape[1], observed.shape[1]
    if samples < 2 or rollouts < 1:
        raise ValueError(
            "MMD² needs at least two forecasts and one observed rollout a scenario, "
            f"not {samples} and {rollouts}"
        )
    if not np.isfinite(observed).all():
        raise ValueError("an observed trajectory has values that are not finite")


def discrepancy(parts: Gaps, samples: int, rollouts: int) -> Discrepancy:
    """Both estimates from the means of 1 - k over all pairs of K samples and L rollouts."""
    biased = 2 * parts.across - parts.among_x - parts.among_y
    squared = biased - parts.among_x / (samples - 1)
    if rollouts > 1:
        squared = squared - parts.among_y / (rollouts - 1)
    # The V-statistic is a squared norm: a negative value is a rounding error.
    return Discrepancy(squared, np.sqrt(np.maximum(biased, 0)))


def at_worst(among_x: Doubles, not_finite: Doubles) -> Doubles:
    """Means of 1 - k over all pairs of forecasts, if those not finite have the kernel 1 with all.

    Args:
        among_x: the means, if they have the kernel 0 with finite forecasts.
        not_finite: the share of forecasts that are not finite, of the same shape.
    """
    return among_x - 2 * not_finite * (1 - not_finite)


def normalize(
    samples: Array, rollouts: Array, scale: Array, bandwidth: Array
) -> tuple[Doubles, Doubles]:
    """Both [..., D] in units of √2 bandwidths, so that k(x, y) = exp(-(x - y)²).

    The origin is the first rollout. Non-finite samples become `INFINITY`.
    """
    unit = np.sqrt(2) * nonzero_scale(scale) * bandwidth
    origin = rollouts[0].astype(np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        x, y = ((values - origin) / unit for values in (samples, rollouts))
        x[~(np.abs(x) < INFINITY)] = INFINITY
    return x, y


def _gaps(
    forecast: Array,
    observed: Array,
    scale: Array,
    bandwidth: Array,
    factors: Sequence[float],
    progress: OnProgress | None = None,
) -> Gaps:
    """Means of 1 - k over all pairs of each scenario, [F, S, T, D]."""
    check_inputs(forecast, observed)
    scenarios, _, steps, dimensions = observed.shape
    means = np.empty((3, len(factors), scenarios, steps, dimensions))
    for scenario, (samples, rollouts) in enumerate(zip(forecast, observed, strict=True)):
        x, y = normalize(samples, rollouts, scale, bandwidth)
        x, y = x.reshape(len(x), -1), y.reshape(len(y), -1)
        parts = gaps(x, y, factors)
        among_x = at_worst(parts.among_x, (x == INFINITY).mean(0))
        for kind, part in enumerate((among_x, parts.among_y, parts.across)):
            means[kind, :, scenario] = part.reshape(-1, steps, dimensions)
        if progress is not None:
            progress((scenario + 1) / scenarios)
    return Gaps(*means)
