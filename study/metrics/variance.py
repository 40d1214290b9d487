"""Variance of forecasts: ratio to the true variance, and its aleatoric and epistemic parts.

The simulator can repeat a scenario from the same s_0 and actions, so the true variance is known.

A *variance ratio* is forecast variance / true variance, for each step and dimension [T, D]. Both
variances are averages over scenarios of the unbiased variance within a scenario. Where the true
variance is negligible the ratio is NaN.

*The* variance ratio of a model is `median_ratio`: the median over seeds, dimensions and the steps
from `FIRST_STEP` on. Tables, pages, `compare`, validation, ablations and recordings of the study
show it. Three uses keep an axis, and say so:

- Figures show each step: the median over seeds and dimensions (`median_of_known`).
- Claims compare dimensions: the mean over all steps of the logarithm of the ratio.
- Rows of scores.parquet over several steps or dimensions are means (`mean_of_known`).

**Non-finite forecasts.** The variance of a forecast that is not finite is infinite, and so is each
ratio, mean and median that includes it. No finite forecast is farther from 1. The epistemic part
and its share are then NaN; they are no scores.
"""

from dataclasses import dataclass

import numpy as np

from study.common.arrays import Array, Booleans, Doubles
from study.metrics.mmd import nonzero_scale

NEGLIGIBLE = 0.01
"""A standard deviation below this share of the training data's is negligible."""

FIRST_STEP = 11
"""First step of `median_ratio`, counted from 1: before it, noise has little effect."""


def variance_ratio(forecast: Array, observed: Array, scale: Array) -> Doubles:
    """Total forecast variance / true variance [T, D]: 1 is best, above 1 the variance is too large.

    Variances are averaged over scenarios before the division. The ratio is NaN where the true
    variance is negligible (see `NEGLIGIBLE`), and infinite where a forecast is not finite.

    Args:
        forecast: [S, K, T, D], K ≥ 2.
        observed: [S, L, T, D], L ≥ 2.
        scale: [D], standard deviations of the training data.
    """
    return _over_true(_infinite_if_not_finite(_mean_variance(forecast)), observed, scale)


def median_ratio(ratio: Array, step: Array) -> float:
    """The median of variance ratios from `FIRST_STEP` on, as `median_of_known`.

    Args:
        ratio: [..., N], such as seeds × places; a place is a step and a dimension.
        step: [N], the step of each place, counted from 1. If all are before `FIRST_STEP`, the last
            one counts.
    """
    ratio, step = np.asarray(ratio, np.float64), np.asarray(step)
    return median_of_known(ratio[..., step >= min(FIRST_STEP, step.max(initial=1))])


def median_of_known(ratio: Array) -> float:
    """The median of all ratios [...] that are not NaN; NaN if all are, infinite if any is."""
    ratio = np.asarray(ratio, np.float64)
    known = ratio[~np.isnan(ratio)]
    if not known.size:
        return float("nan")
    return float("inf") if np.isinf(known).any() else float(np.median(known))


def mean_of_known(values: Array, axis: int | None = None) -> Doubles:
    """The mean over an axis (all if None) of the values that are not NaN; NaN if all are."""
    known = ~np.isnan(values)
    total, count = np.where(known, values, 0).sum(axis), known.sum(axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _over_true(predicted: Doubles, observed: Array, scale: Array) -> Doubles:
    true = _mean_variance(observed)
    known = _is_relevant(true, scale)
    return np.where(known, predicted / np.where(known, true, 1), np.nan)


def _is_relevant(variance: Doubles, scale: Array) -> Booleans:
    """Which variances [T, D] are not negligible."""
    return variance > (NEGLIGIBLE * nonzero_scale(scale)) ** 2


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
    """Variances [S, T, D] of samples from the members of an ensemble."""

    total: Doubles
    aleatoric: Doubles
    epistemic: Doubles


def split(forecast: Array, member: Array) -> Split:
    """The law of total variance for the samples: Var x = E_m[Var(x | m)] + Var_m(E[x | m]).

    The first term is the aleatoric part. The second term, the variance of the members' means, is
    the epistemic part. See Depeweg et al. 2018, which the paper's equations 6 to 8 follow.
    Variances divide by the number of samples, so the identity is exact. With n samples a member,
    1/n of the aleatoric variance is therefore in the epistemic part; `decompose` corrects this
    bias. Variances of a non-finite value are NaN.

    Args:
        forecast: [S, K, T, D].
        member: [S, K] integers, the ensemble member of each sample.
    """
    scenarios, samples, *rest = forecast.shape
    flat = forecast.reshape(scenarios, samples, -1).astype(np.float64)
    flat[~np.isfinite(flat)] = np.nan
    centred = flat - flat.mean(1, keepdims=True)
    from_member = member[:, None, :] == np.arange(member.max() + 1)[:, None]  # [S, M, K]
    count = from_member.sum(2, keepdims=True)  # [S, M, 1]
    means = from_member.astype(np.float64) @ centred / np.maximum(count, 1)  # [S, M, T·D]
    total = (centred**2).mean(1)
    epistemic = (count / samples * means**2).sum(1)
    aleatoric = ((centred - np.take_along_axis(means, member[:, :, None], 1)) ** 2).mean(1)
    shape = (scenarios, *rest)
    return Split(total.reshape(shape), aleatoric.reshape(shape), epistemic.reshape(shape))


@dataclass(frozen=True)
class Decomposition:
    """Forecast variances [T, D], averaged over scenarios."""

    total: Doubles
    aleatoric: Doubles
    epistemic: Doubles


def decompose(forecast: Array, member: Array | None = None) -> Decomposition:
    """Aleatoric, epistemic and total forecast variance, unbiased for any number of samples K.

    The terms are those of the law of total variance, as in `split`, for the distribution of the
    samples. G of the members have samples. The member of each sample is independent, and all
    members are equally likely:

        total      S / (K - 1), where S is the sum of squares about the mean of all samples
        aleatoric  W / (K - G), where W is the sum of squares about the mean of each sample's member
        epistemic  total - aleatoric

    The total is the usual unbiased variance of independent samples. The sum of squares of a member
    with n samples has expectation (n - 1) σ_m². W / (K - G) is therefore a mean of the σ_m² with
    weights (n - 1) / (K - G). The weights sum to one and have equal expectations, so the aleatoric
    part is unbiased, and the epistemic part too. The epistemic part can be negative by chance.

    A member with one sample has weight 0. A scenario in which no member has two samples is left out
    of the average of the aleatoric variance. If this is true of all scenarios, the aleatoric and
    the epistemic part are NaN. Where a sample is not finite, total and aleatoric part are infinite
    and the epistemic part is NaN.

    Args:
        forecast: [S, K, T, D], K ≥ 2.
        member: [S, K] integers, the ensemble member of each sample. None without an ensemble: then
            all variance is aleatoric.
    """
    total = _infinite_if_not_finite(_mean_variance(forecast))
    not_finite = np.isinf(total)
    if member is None:
        return Decomposition(total, total, np.where(not_finite, np.nan, 0.0))
    aleatoric = np.where(not_finite, np.inf, _mean_variance_within(forecast, member))
    with np.errstate(invalid="ignore"):
        return Decomposition(total, aleatoric, total - aleatoric)


def _mean_variance_within(forecast: Array, member: Array) -> Doubles:
    """W / (K - G) of `decompose` [T, D], averaged over the scenarios in which it is defined."""
    samples, *shape = forecast.shape[1:]
    within, scenarios = np.zeros(shape), 0
    for scenario, members in zip(forecast, member, strict=True):
        _, index, size = np.unique(members, return_inverse=True, return_counts=True)
        if len(size) == samples:
            continue
        from_member = (index == np.arange(len(size))[:, None]).astype(np.float64)  # [G, K]
        values = scenario.reshape(samples, -1).astype(np.float64)
        with np.errstate(invalid="ignore", over="ignore"):
            means = from_member @ values / size[:, None]
            squares = ((values - means[index]) ** 2).sum(0)
        within += squares.reshape(shape) / (samples - len(size))
        scenarios += 1
    return within / scenarios if scenarios else np.full(shape, np.nan)


def aleatoric_ratio(predicted: Decomposition, observed: Array, scale: Array) -> Doubles:
    """Aleatoric forecast variance / true variance [T, D]: 1 is best.

    The observed rollouts of a scenario differ by aleatoric noise only, so their variance is the
    true aleatoric variance. A ratio above 1 means that epistemic uncertainty was learned as noise.
    The ratio is NaN or infinite where `variance_ratio` is.

    Args:
        predicted: from `decompose`.
        observed: [S, L, T, D], L ≥ 2.
        scale: [D], standard deviations of the training data.
    """
    return _over_true(predicted.aleatoric, observed, scale)


def epistemic_share(predicted: Decomposition, scale: Array) -> Doubles:
    """Epistemic / total forecast variance [T, D]; can be negative by chance.

    NaN where the total is negligible (see `NEGLIGIBLE`) or not finite.

    Args:
        predicted: from `decompose`.
        scale: [D], standard deviations of the training data.
    """
    known = _is_relevant(predicted.total, scale) & np.isfinite(predicted.total)
    share = np.where(known, predicted.epistemic, 0) / np.where(known, predicted.total, 1)
    return np.where(known, share, np.nan)
