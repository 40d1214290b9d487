"""Calibration: ranks of observed rollouts among the forecasts, for each step and dimension.

If an observed value is exchangeable with K samples, its rank among them is uniform over K + 1
ranks. The module uses the non-randomised probability integral transform (PIT) of Czado, Gneiting
and Held (Biometrics 65, 2009). The PIT of rank r is uniform between r / (K + 1) and
(r + 1) / (K + 1). The PIT of a value equal to m samples is uniform over its m + 1 ranks. The PIT of
the oracle is therefore exactly uniform, for any K and with any ties, without random numbers.

The central interval of probability p contains the PIT values from (1 - p)/2 to (1 + p)/2. Its
coverage is the share of observed values in it. The expected coverage of the oracle is p for any K.

Coverage below p shows a variance that is too small (a U-shaped PIT histogram) or a bias (a slope).
Coverage above p shows a variance that is too large (a hump). Ranks do not depend on distances:
where the observed value never varies, the smallest error puts it outside. Read coverage with a
score.

**Non-finite forecasts.** Where any of the K samples is not finite there is no interval. Coverage is
then -∞, and so is each average that includes it. No finite forecast is farther from the nominal
coverage. In the PIT histogram, which is no score, half of the rollouts then count as below all
samples, half as above.
"""

from collections.abc import Sequence

import numpy as np
import torch

from study.common.arrays import Array, Doubles, Integers

BINS = 20
"""Bins of the PIT histogram."""


def rank_histogram(forecast: Array, observed: Array) -> Doubles:
    """The share of observed rollouts at each rank among the samples, over scenarios and rollouts.

    Returns:
        [T, D, K+3]; the last axis sums to one. Its K+1 inner elements are the ranks. The first and
        last element are PIT 0 and 1, outside any interval: zero where all forecasts are finite.

    Args:
        forecast: [S, K, T, D]. Non-finite values: see the module.
        observed: [S, L, T, D], finite.

    Raises:
        ValueError: a non-finite observed value.
    """
    if not np.isfinite(observed).all():
        raise ValueError("an observed trajectory has values that are not finite")
    scenarios, samples, steps, dimensions = forecast.shape
    rollouts, places = observed.shape[1], steps * dimensions
    # The weight of a rollout is one, in equal parts on its ranks first ≤ r < last. `change` has
    # differences of weights along the ranks; their cumulative sum gives the weights.
    change = np.zeros(places * (samples + 2))
    row = (samples + 2) * np.arange(places)[:, None]
    not_finite = np.zeros(places)
    for x, y in zip(forecast, observed, strict=True):
        x, y = x.reshape(samples, places).T, y.reshape(rollouts, places).T
        finite = np.isfinite(x).all(1)
        not_finite += ~finite
        first, last = _ranks(x, y)
        weight = (finite[:, None] / (last - first)).ravel()
        change += np.bincount((row + first).ravel(), weight, change.size)
        change -= np.bincount((row + last).ravel(), weight, change.size)
    ranks = change.reshape(places, samples + 2)[:, :-1].cumsum(1)
    outside = rollouts / 2 * not_finite[:, None]
    counts = np.hstack([outside, ranks, outside]) / (scenarios * rollouts)
    return counts.reshape(steps, dimensions, samples + 3)


def coverage(ranks: Doubles, probability: float) -> Doubles:
    """Coverage [...] of the central interval of a probability; -∞ where a forecast is not finite.

    Args:
        ranks: [..., K+3], from `rank_histogram`, or an average of several.
        probability: of the interval, between 0 and 1.
    """
    ends = share_below(ranks, [(1 - probability) / 2, (1 + probability) / 2])
    return np.where(ranks[..., 0] > 0, -np.inf, ends[..., 1] - ends[..., 0])


def pit(ranks: Doubles, bins: int = BINS) -> Doubles:
    """The share of observed rollouts in each of `bins` equal bins of the PIT, [..., bins].

    Calibrated forecasts have 1/bins in each.

    Args:
        ranks: [..., K+3], from `rank_histogram`, or an average of several.
        bins: their number.
    """
    # A negative share is a rounding error.
    return np.maximum(np.diff(share_below(ranks, np.linspace(0, 1, bins + 1))), 0)


def share_below(ranks: Doubles, values: Array | Sequence[float]) -> Doubles:
    """The share [..., V] of observed rollouts whose PIT is below each of `values` [V]."""
    values, count = np.asarray(values), ranks.shape[-1] - 2
    within = np.clip(count * values - np.arange(count)[:, None], 0, 1)
    return np.asarray(ranks @ np.vstack([values > 0, within, values >= 1]))


def _ranks(samples: Array, rollouts: Array) -> tuple[Integers, Integers]:
    """First and last + 1 of the possible ranks of each rollout [N, L] among samples [N, K].

    The first is the number of samples below the rollout. Ties with samples give several ranks.
    """
    common = np.result_type(samples, rollouts)
    # Searching for sorted rollouts takes half of the time.
    x, y = (
        torch.from_numpy(np.sort(np.ascontiguousarray(values, common), 1))
        for values in (samples, rollouts)
    )
    below, not_above = (torch.searchsorted(x, y, right=right) for right in (False, True))
    return below.numpy(), not_above.numpy() + 1
