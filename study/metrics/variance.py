"""Variance of forecasts: against the true one, and split into aleatoric and epistemic.

The simulator can be run again from the same s_0 and actions, so the *true* variance is known, and
a forecast that is too wide (variance counted twice) or too narrow shows as a ratio.
"""

from dataclasses import dataclass

import numpy as np

from study.common.arrays import Array, Booleans, Doubles
from study.metrics.mmd import standard

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
    return _over_true(_infinite_if_not_finite(_mean_variance(forecast)), observed, scale)


def mean_of_known(values: Array, axis: int | None = None) -> Doubles:
    """The mean over an axis (all if None) of what is not NaN; NaN if nothing is known."""
    known = ~np.isnan(values)
    total, count = np.where(known, values, 0).sum(axis), known.sum(axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _over_true(predicted: Doubles, observed: Array, scale: Array) -> Doubles:
    true = _mean_variance(observed)
    known = _counts(true, scale)
    return np.where(known, predicted / np.where(known, true, 1), np.nan)


def _counts(variance: Doubles, scale: Array) -> Booleans:
    """Which variances [T, D] are not negligible."""
    return variance > (NEGLIGIBLE * standard(scale)) ** 2


def _infinite_if_not_finite(variance: Doubles) -> Doubles:
    return np.where(np.isfinite(variance), variance, np.inf)


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


@dataclass(frozen=True)
class Decomposition:
    """Predicted variances [T, D], averages over scenarios."""

    total: Doubles
    aleatoric: Doubles
    epistemic: Doubles


def decompose(forecast: Array, member: Array | None = None) -> Decomposition:
    """Aleatoric, epistemic and total variance that forecasts predict, unbiased for any K.

    The terms of the law of total variance, as in `split`, but of the distribution from which the
    samples are drawn, and not of the samples at hand. With K samples of G members, each sample's
    member drawn on its own and all equally likely,

        total      S / (K - 1), S the sum of squares about the mean of all samples
        aleatoric  W / (K - G), W the sum of squares, each about the mean of its own member
        epistemic  total - aleatoric

    The total is the ordinary unbiased variance of independent draws. A member's sum of squares
    averages (n - 1) σ_m² with n samples, so W / (K - G) is a mean of the σ_m² with weights
    (n - 1) / (K - G), which sum to one and on average are equal, since the draw favours no member.
    So the difference is unbiased: the 1/n of the aleatoric variance that each member's mean shows
    by chance is not in it. By chance it may be below zero; it is not clipped.

    A member with one sample tells nothing of its own spread: its weight above is 0. A scenario in
    which no member has two is left out of the average of the aleatoric variance (members are drawn
    without regard to scenarios, so this favours none); if that is every scenario, aleatoric and
    epistemic are NaN. Where a sample is not finite, total and aleatoric are infinite and epistemic
    is NaN.

    Args:
        forecast: [S, K, T, D], K ≥ 2.
        member: [S, K] integers, the member from which each sample comes; None if there is no
            ensemble: then all variance is aleatoric.
    """
    total = _infinite_if_not_finite(_mean_variance(forecast))
    lost = np.isinf(total)
    if member is None:
        return Decomposition(total, total, np.where(lost, np.nan, 0.0))
    aleatoric = np.where(lost, np.inf, _mean_variance_within(forecast, member))
    with np.errstate(invalid="ignore"):
        return Decomposition(total, aleatoric, total - aleatoric)


def _mean_variance_within(forecast: Array, member: Array) -> Doubles:
    """W / (K - G) of `decompose`, [T, D], averaged over the scenarios that have it."""
    samples, *shape = forecast.shape[1:]
    within, told = np.zeros(shape), 0
    for scenario, own in zip(forecast, member, strict=True):
        _, index, size = np.unique(own, return_inverse=True, return_counts=True)
        if len(size) == samples:
            continue
        belongs = (index == np.arange(len(size))[:, None]).astype(np.float64)  # [G, K]
        values = scenario.reshape(samples, -1).astype(np.float64)
        with np.errstate(invalid="ignore", over="ignore"):
            means = belongs @ values / size[:, None]
            squares = ((values - means[index]) ** 2).sum(0)
        within += squares.reshape(shape) / (samples - len(size))
        told += 1
    return within / told if told else np.full(shape, np.nan)


def aleatoric_ratio(predicted: Decomposition, observed: Array, scale: Array) -> Doubles:
    """Predicted aleatoric variance / true variance, [T, D]: 1 is right.

    The observed rollouts of a scenario differ by aleatoric noise alone, so their variance is the
    true aleatoric one. Above 1, what is not known of the model was counted as noise. NaN and
    infinite where `variance_ratio` is.

    Args:
        predicted: from `decompose`.
        observed: [S, L, T, D], L ≥ 2.
        scale: [D], standard deviations of the training data.
    """
    return _over_true(predicted.aleatoric, observed, scale)


def epistemic_share(predicted: Decomposition, scale: Array) -> Doubles:
    """Epistemic / total predicted variance, [T, D].

    NaN where the total is negligible (see `NEGLIGIBLE`) or not finite. Below zero by chance.
    """
    known = _counts(predicted.total, scale) & np.isfinite(predicted.total)
    share = np.where(known, predicted.epistemic, 0) / np.where(known, predicted.total, 1)
    return np.where(known, share, np.nan)


@dataclass(frozen=True)
class Residuals:
    """Mean squares [T, D] of the paper's residuals."""

    total: Doubles
    aleatoric: Doubles
    epistemic: Doubles


def residuals(observed: Array, members: Array) -> Residuals:
    """Mean squares of ε_total, ε_alea and ε_epist, the paper's equations (6) to (8).

    With ŷ_m the forecast of member m and ȳ their mean: ε_total = y - ȳ, ε_epist = ŷ_m - ȳ and
    ε_alea = y - ŷ_m. Since the mean of ε_epist over members is zero, the mean squares obey

        aleatoric = total + epistemic

    So as residuals the two parts subtract, but what a model learns from ε_alea varies *more* than
    the total residual, by all of the epistemic variance: only by adding it to the same member's
    forecast can it give back what was observed. And what all members get wrong is in ε_alea, not
    in ε_epist.

    Args:
        observed: [S, L, T, D], y.
        members: [S, M, T, D], ŷ_m, each member's forecast without noise. Non-finite values spread
            to the mean squares of their place.
    """
    scenarios, _, *shape = observed.shape
    total, aleatoric, epistemic = (np.zeros(shape) for _ in range(3))
    with np.errstate(invalid="ignore", over="ignore"):
        for y, of_members in zip(observed, members.astype(np.float64), strict=True):
            centre = of_members.mean(0)
            total += ((y - centre) ** 2).mean(0)
            epistemic += ((of_members - centre) ** 2).mean(0)
            aleatoric += np.mean([((y - forecast) ** 2).mean(0) for forecast in of_members], 0)
    return Residuals(*(part / scenarios for part in (total, aleatoric, epistemic)))
