"""Maximum mean discrepancy of whole states, which is sensitive to dependence between dimensions.

MMD of one dimension at a time (`study.metrics.mmd`) does not change if the samples of each
dimension are permuted. The kernel of this module is the geometric mean of the D kernels of the
dimensions of two states x and y,

    k(x, y) = Π_d exp(-(x_d - y_d)² / 2h_d²)^(1/D) = exp(-Σ_d (x_d - y_d)² / 2Dh_d²)

It is a Gaussian kernel on the normalized state, with √D times the bandwidth of each dimension. The
bandwidth h_d is the median distance in dimension d. For two typical rollouts the exponent is
therefore about ½ for any D, and all dimensions have equal weight. The estimators are those of
`study.metrics.mmd`.

**Non-finite forecasts.** A state with a non-finite value in any dimension has the kernel 1 with
every forecast and 0 with every observed state, as in `study.metrics.mmd`. No finite state in its
place scores worse. No sample is dropped.
"""

import numpy as np
import torch
from scipy.spatial.distance import cdist

from study.common.arrays import Array, Doubles
from study.metrics.device import at_once, score_device
from study.metrics.kernel_sums import Gaps
from study.metrics.mmd import (
    INFINITY,
    Discrepancy,
    OnProgress,
    at_worst,
    check_inputs,
    discrepancy,
    normalize,
)

FAR = 1e3
"""Beyond this size, in √2 bandwidths, |x|² + |y|² - 2xy is too inexact for |x - y|²."""

AT_ONCE = 2**18
"""Kernels that are computed at once: so many fit into the processor's cache."""


def joint_mmd(
    forecast: Array,
    observed: Array,
    scale: Array,
    bandwidth: Array,
    progress: OnProgress | None = None,
) -> Discrepancy:
    """MMD [S, T] between forecast and observed states of the same scenario and step.

    Args:
        forecast: [S, K, T, D], physical units, K ≥ 2. Non-finite values: see the module.
        observed: [S, L, T, D], physical units, L ≥ 2, finite.
        scale: [D], standard deviations of the training data.
        bandwidth: [D], in units of `scale`, of the kernel of each dimension.
        progress: called with the fraction that is done.

    Raises:
        ValueError: fewer than two samples on a side, or a non-finite observed value.
    """
    check_inputs(forecast, observed)
    scenarios, rollouts, steps, dimensions = observed.shape
    joint = np.sqrt(dimensions) * np.asarray(bandwidth)
    means = np.empty((3, scenarios, steps))
    size = max(1, at_once(AT_ONCE) // max(forecast.shape[1], rollouts) ** 2)
    for scenario, pair in enumerate(zip(forecast, observed, strict=True)):
        x, y = normalize(*pair, scale, joint)
        not_finite = (x == INFINITY).any(-1)
        x[not_finite] = INFINITY
        x, y = (np.ascontiguousarray(states.swapaxes(0, 1)) for states in (x, y))
        for start in range(0, steps, size):
            part = slice(start, start + size)
            for kind, (first, second) in enumerate(((x, x), (y, y), (x, y))):
                means[kind, scenario, part] = _mean_gap(first[part], second[part])
        means[0, scenario] = at_worst(means[0, scenario], not_finite.mean(0))
        if progress is not None:
            progress((scenario + 1) / scenarios)
    return discrepancy(Gaps(*means), forecast.shape[1], rollouts)


def _mean_gap(x: Doubles, y: Doubles) -> Doubles:
    """Mean of 1 - exp(-|x - y|²) over all pairs of x [T, K, D] and y [T, L, D]: [T]."""
    near = max(np.abs(x).max(), np.abs(y).max()) < FAR
    device = score_device()
    if near and device is not None:
        return _mean_gap_on(device, x, y)
    exponent = (_by_product if near else _by_difference)(x, y).astype(np.float32)
    # exp(-80) does not change a mean. Denormal numbers would take ten times as long.
    kernel = np.exp(np.maximum(exponent, -80, out=exponent), out=exponent)
    return np.asarray(1 - kernel.mean((1, 2), dtype=np.float64))


def _mean_gap_on(device: torch.device, x: Doubles, y: Doubles) -> Doubles:
    """See `_mean_gap`: on a GPU, in float64."""
    first, second = (torch.from_numpy(states).to(device) for states in (x, y))
    kernel = torch.cdist(first, second).square().neg().exp()
    return np.asarray(1 - kernel.mean((1, 2)).cpu().numpy())


def _by_product(x: Doubles, y: Doubles) -> Doubles:
    """-|x - y|² [T, K, L] as one matrix product."""
    x_norm, y_norm = (np.square(states).sum(-1, keepdims=True) for states in (x, y))
    left = np.concatenate([2 * x, -x_norm, -np.ones_like(x_norm)], -1)
    right = np.concatenate([y, np.ones_like(y_norm), y_norm], -1)
    return np.asarray(left @ right.swapaxes(1, 2))


def _by_difference(x: Doubles, y: Doubles) -> Doubles:
    """-|x - y|² [T, K, L], exact for any x and y, but slower."""
    return -np.stack([cdist(*pair, "sqeuclidean") for pair in zip(x, y, strict=True)])
