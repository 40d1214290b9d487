"""Proper scores of forecast trajectories: CRPS of each dimension, energy score of the whole state.

The samples x_1 … x_K and the observed rollout y of a scenario are in standard deviations of the
training data:

    CRPS            mean_i |x_i - y| - ½ mean_{i≠j} |x_i - x_j|
    energy score    mean_i ‖x_i - y‖ - ½ mean_{i≠j} ‖x_i - x_j‖

See Gneiting and Raftery, JASA 102, 2007, equations 21 and 22. Both scores are fair in the number
of samples (Ferro 2014). Both are averaged over all observed rollouts y of the scenario. Lower is
better. The true distribution has the lowest expected score for any K. A single value can be
negative. Both scores penalise a variance that is too small, which a kernel with one bandwidth does
little.

The scores equal `crps_ensemble` and `es_ensemble` of `scoringrules` with the estimator "fair"; the
tests compare them. Those functions take one observation at a time. The functions of this module
average over all observations at once, which is several times as fast for the CRPS and some hundred
times for the energy score.

**Non-finite forecasts.** Where any of the K samples is not finite, the score is infinite, and so is
each average that includes it. No finite forecast scores worse, and no sample is dropped.
"""

import numpy as np
import torch

from study.common.arrays import Array, Doubles
from study.metrics.device import at_once, score_device
from study.metrics.mmd import nonzero_scale

STEPS_AT_ONCE = 20
"""Steps whose distances are computed together on a CPU: so many fit into its cache."""


def crps(forecast: Array, observed: Array, scale: Array) -> Doubles:
    """Fair CRPS [S, T, D] in units of `scale`, averaged over the observed rollouts.

    Args:
        forecast: [S, K, T, D], physical units, K ≥ 2. Non-finite values: see the module.
        observed: [S, L, T, D], physical units, finite.
        scale: [D], standard deviations of the training data.

    Raises:
        ValueError: fewer than two samples, or a non-finite observed value.
    """
    _check(forecast, observed)
    scenarios, samples, steps, dimensions = forecast.shape
    rollouts = observed.shape[1]
    score = np.empty((scenarios, steps * dimensions))
    for scenario in range(scenarios):
        x, y = _normalize(forecast[scenario], observed[scenario], scale)
        x, y = x.reshape(samples, -1).T, y.reshape(rollouts, -1).T
        with np.errstate(invalid="ignore", over="ignore"):
            among = _between_pairs(x)
            # The pairs across are all pairs of the pooled values, less those within each sample.
            across = _between_pairs(np.hstack([x, y])) - among - _between_pairs(y)
            score[scenario] = across / (samples * rollouts) - among / (samples * (samples - 1))
    return _worst_if_not_finite(score).reshape(scenarios, steps, dimensions)


def energy_score(forecast: Array, observed: Array, scale: Array) -> Doubles:
    """Fair energy score [S, T] of the normalized state, averaged over the observed rollouts.

    Unlike the CRPS it is sensitive to dependence between dimensions. Arguments and errors are those
    of `crps`.
    """
    _check(forecast, observed)
    scenarios, samples, steps, _ = forecast.shape
    rollouts = observed.shape[1]
    pairs = samples * (samples + rollouts)
    size = max(1, at_once(STEPS_AT_ONCE * pairs) // pairs)
    score = np.empty((scenarios, steps))
    for scenario in range(scenarios):
        x, y = _normalize(forecast[scenario], observed[scenario], scale)
        by_step = torch.from_numpy(np.concatenate([x, y]).swapaxes(0, 1).copy())  # [T, K+L, D]
        by_step = by_step.to(score_device() or "cpu")
        for start in range(0, steps, size):
            part = slice(start, start + size)
            distance = torch.cdist(by_step[part, :samples], by_step[part])
            among = distance[:, :, :samples].sum((1, 2)).cpu().numpy() / (samples * (samples - 1))
            across = distance[:, :, samples:].sum((1, 2)).cpu().numpy() / (samples * rollouts)
            with np.errstate(invalid="ignore"):
                score[scenario, part] = across - among / 2
    return _worst_if_not_finite(score)


def _check(forecast: Array, observed: Array) -> None:
    if forecast.shape[1] < 2:
        raise ValueError(
            f"a fair score needs at least two forecasts a scenario, not {forecast.shape[1]}"
        )
    if not np.isfinite(observed).all():
        raise ValueError("an observed trajectory has values that are not finite")


def _normalize(samples: Array, rollouts: Array, scale: Array) -> tuple[Doubles, Doubles]:
    """Both in units of `scale`, relative to the mean of the rollouts [L, T, D]."""
    unit, centre = nonzero_scale(scale), rollouts.mean(0, dtype=np.float64)
    return (samples - centre) / unit, (rollouts - centre) / unit


def _between_pairs(values: Doubles) -> Doubles:
    """The sum [N] of |v_i - v_j| over the pairs i < j of values [N, n].

    In a sorted row, v_i is the larger value of i pairs and the smaller value of n - 1 - i pairs.
    """
    count = values.shape[1]
    return np.asarray(np.sort(values, axis=1) @ (2.0 * np.arange(count) - (count - 1)))


def _worst_if_not_finite(score: Doubles) -> Doubles:
    return np.where(np.isfinite(score), score, np.inf)
