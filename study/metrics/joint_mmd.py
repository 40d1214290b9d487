"""Maximum mean discrepancy of whole states: it sees dependence between dimensions.

MMD of one dimension at a time (`study.metrics.mmd`) cannot tell states whose dimensions belong
together from states whose dimensions were shuffled. Here the kernel between two states x and y is
the geometric mean of the D kernels of their dimensions,

    k(x, y) = Π_d exp(-(x_d - y_d)² / 2h_d²)^(1/D) = exp(-Σ_d (x_d - y_d)² / 2Dh_d²)

a Gaussian kernel on the standardised state, √D times as wide as the kernel of each dimension, with
the same bandwidths h. As h_d is the median distance in dimension d, the exponent is about ½ for
two typical rollouts whatever D: the kernel is neither 0 nor 1 everywhere, and every dimension has
the same say. Estimators are those of `study.metrics.mmd`.

**Non-finite forecasts.** A state with a value that is not finite, in any dimension, is the same
state at infinity: its kernel is 0 with every other and 1 with its like. None is dropped.
"""

import numpy as np
from scipy.spatial.distance import cdist

from study.common.arrays import Array, Doubles
from study.metrics.kernel_sums import Gaps
from study.metrics.mmd import INFINITY, Discrepancy, Told, check, discrepancy, standardise

FAR = 1e3
"""From here on, in √2 bandwidths, |x|² + |y|² - 2xy loses more digits than |x - y|² can spare."""

AT_ONCE = 2**18
"""Kernels that are computed at once: they stay in the cache."""


def joint_mmd(
    forecast: Array,
    observed: Array,
    scale: Array,
    bandwidth: Array,
    progress: Told | None = None,
) -> Discrepancy:
    """Discrepancy [S, T] between forecast and observed states of the same scenario and step.

    Args:
        forecast: [S, K, T, D], physical units, K ≥ 2. Non-finite values: see the module.
        observed: [S, L, T, D], physical units, L ≥ 2, finite.
        scale: [D], standard deviations of the training data.
        bandwidth: [D], in units of `scale`, of each dimension's own kernel.
        progress: told the share that is done, 0 to 1.

    Raises:
        ValueError: fewer than two samples on a side, or a non-finite observed value.
    """
    check(forecast, observed)
    scenarios, rollouts, steps, dimensions = observed.shape
    joint = np.sqrt(dimensions) * np.asarray(bandwidth)
    found = np.empty((3, scenarios, steps))
    size = max(1, AT_ONCE // max(forecast.shape[1], rollouts) ** 2)
    for scenario, pair in enumerate(zip(forecast, observed, strict=True)):
        x, y = standardise(*pair, scale, joint)
        x[(x == INFINITY).any(-1)] = INFINITY
        x, y = (np.ascontiguousarray(z.swapaxes(0, 1)) for z in (x, y))
        for start in range(0, steps, size):
            part = slice(start, start + size)
            for kind, (one, other) in enumerate(((x, x), (y, y), (x, y))):
                found[kind, scenario, part] = _mean_gap(one[part], other[part])
        if progress is not None:
            progress((scenario + 1) / scenarios)
    return discrepancy(Gaps(*found), forecast.shape[1], rollouts)


def _mean_gap(x: Doubles, y: Doubles) -> Doubles:
    """Mean of 1 - exp(-|x - y|²) over all pairs of x [T, K, D] and y [T, L, D]: [T]."""
    near = max(np.abs(x).max(), np.abs(y).max()) < FAR
    exponent = (_by_product if near else _by_difference)(x, y).astype(np.float32)
    # exp(-80) is nothing beside a mean, while a denormal number takes ten times as long.
    kernel = np.exp(np.maximum(exponent, -80, out=exponent), out=exponent)
    return np.asarray(1 - kernel.mean((1, 2), dtype=np.float64))


def _by_product(x: Doubles, y: Doubles) -> Doubles:
    """-|x - y|² as one matrix product, [T, K, L]."""
    one, other = (np.square(z).sum(-1, keepdims=True) for z in (x, y))
    left = np.concatenate([2 * x, -one, -np.ones_like(one)], -1)
    right = np.concatenate([y, np.ones_like(other), other], -1)
    return np.asarray(left @ right.swapaxes(1, 2))


def _by_difference(x: Doubles, y: Doubles) -> Doubles:
    """-|x - y|², exact for any x and y, but slower: [T, K, L]."""
    return -np.stack([cdist(*pair, "sqeuclidean") for pair in zip(x, y, strict=True)])
