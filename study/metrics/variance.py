"""Variance of forecasts: against the true one, and split into aleatoric and epistemic.

The simulator can be run again from the same s_0 and actions, so the *true* variance is known, and
a forecast that is too wide (variance counted twice) or too narrow shows as a ratio.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from study.metrics.mmd import standard

Array = NDArray[Any]
Doubles = NDArray[np.float64]

NEGLIGIBLE = 0.01
"""A true standard deviation below this share of the training data's is no variation at all."""


def variance_ratio(forecast: Array, observed: Array, scale: Array) -> Doubles:
    """Predicted variance / true variance, [T, D]: 1 is right, above 1 too wide.

    Both are unbiased variances within a scenario, averaged over scenarios before they are divided.
    Where the true variance is negligible (see `NEGLIGIBLE`) the ratio means nothing and is NaN;
    where a forecast holds a value that is not finite it is infinite.

    Args:
        forecast: [S, K, T, D], K ≥ 2.
        observed: [S, L, T, D], L ≥ 2.
        scale: [D], standard deviations of the training data.
    """
    true = _mean_variance(observed)
    predicted = _mean_variance(forecast)
    predicted[~np.isfinite(predicted)] = np.inf
    known = true > (NEGLIGIBLE * standard(scale)) ** 2
    return np.where(known, predicted / np.where(known, true, 1), np.nan)


def _mean_variance(samples: Array) -> Doubles:
    total = np.zeros(samples.shape[2:])
    with np.errstate(invalid="ignore", over="ignore"):
        for scenario in samples:
            total += scenario.var(0, ddof=1, dtype=np.float64)
    return total / len(samples)


@dataclass(frozen=True)
class Split:
    """Variances [S, T, D] of samples that each come from one member of an ensemble."""

    total: Doubles
    aleatoric: Doubles
    epistemic: Doubles


def split(forecast: Array, member: Array) -> Split:
    """The law of total variance: Var x = E_m[Var(x | m)] + Var_m(E[x | m]).

    The first term is aleatoric, the second, the variance of the members' means, epistemic (Depeweg
    et al. 2018, which the paper's equations 6 to 8 follow). The identity is exact: variances divide
    by the number of samples. So with n samples a member, 1/n of the aleatoric variance shows as
    epistemic. A value that is not finite makes the variances of its place NaN.

    Args:
        forecast: [S, K, T, D].
        member: [S, K] integers, the member from which each sample comes.
    """
    scenarios, samples, *rest = forecast.shape
    flat = forecast.reshape(scenarios, samples, -1).astype(np.float64)
    flat[~np.isfinite(flat)] = np.nan
    centred = flat - flat.mean(1, keepdims=True)
    belongs = member[:, None, :] == np.arange(member.max() + 1)[:, None]  # [S, M, K]
    count = belongs.sum(2, keepdims=True)  # [S, M, 1]
    means = belongs.astype(np.float64) @ centred / np.maximum(count, 1)  # [S, M, T·D]
    total = (centred**2).mean(1)
    epistemic = (count / samples * means**2).sum(1)
    aleatoric = ((centred - np.take_along_axis(means, member[:, :, None], 1)) ** 2).mean(1)
    shape = (scenarios, *rest)
    return Split(total.reshape(shape), aleatoric.reshape(shape), epistemic.reshape(shape))
