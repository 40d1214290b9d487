"""Calibration: where observed rollouts fall among the forecasts, for each step and dimension.

If an observed value is exchangeable with K samples, its rank among them is uniform over K + 1
ranks. The probability integral transform (PIT) of rank r is taken as uniform between r / (K + 1)
and (r + 1) / (K + 1), and that of a value equal to m samples as uniform over its m + 1 ranks: the
non-randomised PIT of Czado, Gneiting and Held (Biometrics 65, 2009). So it is exactly uniform for
the oracle, for any K and with any ties, and nothing is drawn at random.

The central interval of probability p holds the PIT values from (1 - p)/2 to (1 + p)/2. Its coverage
is the share of them that falls there, which for the oracle is p on average, for any K.

Coverage below p: forecasts too narrow or off the mark (a PIT histogram like a U or a slope); above
p: too wide (a hump). Ranks know no size: a forecast a hair beside a value that never varies is
outside, as if it were a mile away. So read coverage together with a score.

**Non-finite forecasts.** Where any of the K samples is not finite there is no interval: it covers
no rollout, and half of the rollouts count as below all samples, half as above.
"""

from collections.abc import Sequence

import numpy as np
import torch

from study.common.arrays import Array, Doubles, Integers

BINS = 20


def rank_histogram(forecast: Array, observed: Array) -> Doubles:
    """The share of observed rollouts at each rank among the samples: [T, D, K+3], sums to one.

    Averages over scenarios and rollouts. Before and after the K+1 ranks stand those with PIT
    0 and 1, outside any interval: there are some only where a forecast is not finite.

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
    # A rollout spreads a weight of one evenly over its ranks, first ≤ r < last. Weights are kept as
    # differences along the ranks, and summed up in the end.
    change = np.zeros(places * (samples + 2))
    row = (samples + 2) * np.arange(places)[:, None]
    lost = np.zeros(places)
    for x, y in zip(forecast, observed, strict=True):
        x, y = x.reshape(samples, places).T, y.reshape(rollouts, places).T
        known = np.isfinite(x).all(1)
        lost += ~known
        first, last = _ranks(x, y)
        weight = (known[:, None] / (last - first)).ravel()
        change += np.bincount((row + first).ravel(), weight, change.size)
        change -= np.bincount((row + last).ravel(), weight, change.size)
    ranks = change.reshape(places, samples + 2)[:, :-1].cumsum(1)
    outside = rollouts / 2 * lost[:, None]
    counts = np.hstack([outside, ranks, outside]) / (scenarios * rollouts)
    return counts.reshape(steps, dimensions, samples + 3)


def coverage(ranks: Doubles, probability: float) -> Doubles:
    """Coverage of the central interval of that probability, [...] of `rank_histogram` [..., K+3].

    Averages of histograms, over steps say, serve as well as a histogram.
    """
    ends = share_below(ranks, [(1 - probability) / 2, (1 + probability) / 2])
    return ends[..., 1] - ends[..., 0]


def pit(ranks: Doubles, bins: int = BINS) -> Doubles:
    """The share of observed rollouts in each of `bins` equal bins of the PIT, [..., bins].

    `ranks` is a `rank_histogram` [..., K+3], or an average of some. 1/bins each is calibrated.
    """
    # Only rounding can take a share below zero.
    return np.maximum(np.diff(share_below(ranks, np.linspace(0, 1, bins + 1))), 0)


def share_below(ranks: Doubles, values: Array | Sequence[float]) -> Doubles:
    """The share of observed rollouts whose PIT is below each of `values` [V]: [..., V].

    All are below 1.
    """
    values, count = np.asarray(values), ranks.shape[-1] - 2
    within = np.clip(count * values - np.arange(count)[:, None], 0, 1)
    return np.asarray(ranks @ np.vstack([values > 0, within, values >= 1]))


def _ranks(samples: Array, rollouts: Array) -> tuple[Integers, Integers]:
    """How many samples [N, K] are below each rollout [N, L], and one more than are not above it.

    Between the two, first ≤ r < last, lie the ranks that the rollout could have: [N, L] each.
    """
    common = np.result_type(samples, rollouts)
    # Sorted rollouts are found near each other: it halves the time of the search.
    x, y = (
        torch.from_numpy(np.sort(np.ascontiguousarray(values, common), 1))
        for values in (samples, rollouts)
    )
    below, not_above = (torch.searchsorted(x, y, right=right) for right in (False, True))
    return below.numpy(), not_above.numpy() + 1
