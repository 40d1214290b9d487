"""Maximum mean discrepancy with a Gaussian kernel, for each scenario, step and state dimension.

Section IV-D of the paper: "each forecasted state dimension is compared with the corresponding
environmental observation at a temporal level". With k(x, y) = exp(-(x - y)² / 2h²), on states
standardised by the training data, and samples x_1 … x_K (forecast), y_1 … y_L (observed):

    unbiased MMD²   mean_{i≠j} k(x_i, x_j) + mean_{i≠j} k(y_i, y_j) - 2 mean_{ij} k(x_i, y_j)
    biased MMD      the root of the same with the diagonals i = j kept

(Gretton et al., "A kernel two-sample test", JMLR 13, 2012, equations 3 and 5.) The unbiased one
averages zero for equal distributions, so it may be negative; the biased one never is.

**Non-finite forecasts.** Every value that is not finite, or lies more than 1e15 bandwidths from
the observed, is taken as the same point at infinity: its kernel is 0 with every other value and 1
with its like. No finite forecast can score worse, and none is dropped.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

Array = NDArray[Any]
Doubles = NDArray[np.float64]

FLOOR = 0.1
"""Least bandwidth, in standard deviations of the training data: a smaller error does not matter."""

PAIRS = 16
"""Pairs of observed rollouts of each scenario that the median heuristic looks at."""

INFINITY = 1e15
"""Where the point at infinity is, in bandwidths: its square is still a finite float32."""


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
    """How far forecasts are from observed rollouts, both [S, T, D]."""

    squared: Doubles
    """Unbiased MMD²; averages zero for equal distributions, may be negative."""
    biased: Doubles
    """Biased MMD, the root of the V-statistic; never negative, and above zero by chance."""


def similarity(observed: Array, scale: Array, bandwidth: Array) -> Doubles:
    """Mean kernel between two different observed rollouts, [S, T, D].

    The part of MMD² that is the same for every model: compute it once, give it to each `mmd`.
    """
    _refuse_non_finite(observed)
    among = np.empty(_kernel_shape(observed))
    for scenario, rollouts in enumerate(observed):
        among[scenario] = _among(_standardise(rollouts, rollouts, scale, bandwidth))
    return among


def mmd(
    forecast: Array,
    observed: Array,
    scale: Array,
    bandwidth: Array,
    among_observed: Doubles | None = None,
    progress: Callable[[float], None] | None = None,
) -> Discrepancy:
    """Discrepancy between forecasts and observed rollouts of the same scenario.

    Args:
        forecast: [S, K, T, D], physical units, K ≥ 2. Non-finite values: see the module.
        observed: [S, L, T, D], physical units, L ≥ 2, finite.
        scale: [D], standard deviations of the training data.
        bandwidth: [D], in units of `scale`.
        among_observed: [S, T, D] from `similarity`; computed here if not given.
        progress: told the share that is done, 0 to 1.

    Raises:
        ValueError: fewer than two samples on a side, or a non-finite observed value.
    """
    if min(forecast.shape[1], observed.shape[1]) < 2:
        raise ValueError("MMD² needs at least two forecasts and two observed rollouts a scenario")
    if among_observed is None:
        among_observed = similarity(observed, scale, bandwidth)
    among = np.empty(_kernel_shape(observed))
    across = np.empty_like(among)
    for scenario, (samples, rollouts) in enumerate(zip(forecast, observed, strict=True)):
        x = _standardise(samples, rollouts, scale, bandwidth)
        y = _standardise(rollouts, rollouts, scale, bandwidth)
        among[scenario] = _among(x)
        across[scenario] = _across(x, y)
        if progress is not None:
            progress((scenario + 1) / len(forecast))
    squared = among + among_observed - 2 * across
    with_diagonal = (
        _with_diagonal(among, forecast.shape[1])
        + _with_diagonal(among_observed, observed.shape[1])
        - 2 * across
    )
    # The V-statistic is a squared norm: only rounding can take it below zero.
    return Discrepancy(squared, np.sqrt(np.maximum(with_diagonal, 0)))


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
    if forecast.shape[1] < 2:
        raise ValueError("the fair kernel score needs at least two forecasts")
    _refuse_non_finite(observation)
    total = 0.0
    for samples, truth in zip(forecast, observation[:, None], strict=True):
        x = _standardise(samples, truth, scale, bandwidth)
        y = _standardise(truth, truth, scale, bandwidth)
        total += float(np.mean(_among(x) - 2 * _across(x, y)))
    return total / len(forecast)


def _kernel_shape(observed: Array) -> tuple[int, int, int]:
    scenarios, _, steps, dimensions = observed.shape
    return scenarios, steps, dimensions


def _refuse_non_finite(observed: Array) -> None:
    if not np.isfinite(observed).all():
        raise ValueError("an observed trajectory has values that are not finite")


def _standardise(samples: Array, rollouts: Array, scale: Array, bandwidth: Array) -> torch.Tensor:
    """Samples [K, T, D] in units of √2 bandwidths, so that k(x, y) = exp(-(x - y)²), float32.

    Measured from the mean of the rollouts: small numbers lose little to float32.
    """
    unit = np.sqrt(2) * standard(scale) * bandwidth
    with np.errstate(invalid="ignore", over="ignore"):
        values = (samples.astype(np.float64) - rollouts.mean(0, dtype=np.float64)) / unit
        values[~(np.abs(values) < INFINITY)] = INFINITY
    return torch.from_numpy(values.astype(np.float32))


def _among(x: torch.Tensor) -> Doubles:
    """Mean kernel over the pairs i ≠ j of x [K, T, D]: [T, D]."""
    count = len(x)
    total = torch.zeros(x.shape[1:], dtype=torch.float64)
    buffer = torch.empty_like(x)
    # The kernel is symmetric: rows a lag apart, for each lag, meet every pair once.
    for lag in range(1, count):
        total += _kernel(x[lag:], x[:-lag], buffer[lag:]).sum(0)
    return (total / (count * (count - 1) / 2)).numpy()


def _across(x: torch.Tensor, y: torch.Tensor) -> Doubles:
    """Mean kernel between x [K, T, D] and y [L, T, D]: [T, D]."""
    total = torch.zeros(x.shape[1:], dtype=torch.float64)
    buffer = torch.empty_like(x)
    for row in y:
        total += _kernel(x, row, buffer).sum(0)
    return (total / (len(x) * len(y))).numpy()


def _kernel(x: torch.Tensor, y: torch.Tensor, out: torch.Tensor) -> torch.Tensor:
    """exp(-(x - y)²), written to `out`."""
    torch.sub(x, y, out=out)
    # exp(-80) is nothing beside a mean, while a denormal number takes ten times as long.
    return out.mul_(out).clamp_(max=80.0).neg_().exp_()


def _with_diagonal(among: Doubles, count: int) -> Doubles:
    return (1 + (count - 1) * among) / count
