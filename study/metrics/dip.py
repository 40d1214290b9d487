"""Hartigans' dip: the distance of a sample to the nearest unimodal distribution.

See Hartigan and Hartigan, "The dip test of unimodality", Annals of Statistics 13, 1985. The package
`diptest` computes the same numbers, but its licence, the GPL, does not fit this project's.
"""

import numpy as np
from numpy.typing import NDArray

from study.common.arrays import Booleans, Doubles

Indices = NDArray[np.intp]


def dip(samples: Doubles) -> Doubles:
    """Hartigans' dip [S] of samples [S, K], all finite.

    The distance of two distributions is the largest difference of their distribution functions. A
    unimodal distribution function is convex below the mode and concave above. The nearest one
    therefore follows the greatest convex minorant of the sample's distribution function at first,
    and its least concave majorant at the end. The algorithm of the paper starts with an interval of
    all values. It repeatedly shrinks the interval to the two touching points around the largest
    distance of minorant and majorant. The dip is half the largest distance between the sample and
    the curves outside the interval. Equal values are one atom; a unimodal distribution can have an
    atom at its mode only.
    """
    x = np.sort(samples, axis=1)
    scenarios, count = x.shape
    # The distribution function just below and at each value; equal values share both.
    index = np.arange(count)
    first = np.concatenate([np.ones((scenarios, 1), bool), x[:, 1:] > x[:, :-1]], axis=1)
    last = np.concatenate([first[:, 1:], np.ones((scenarios, 1), bool)], axis=1)
    before = _latest(first, index) / count
    at = (_next(last, index) + 1) / count

    below, above = _Minorant(x, before), _Minorant(_rotate(x), _rotate(at))
    low, high = np.zeros((scenarios, 1), np.intp), np.full((scenarios, 1), count - 1)
    twice = np.zeros(scenarios)
    while True:
        minorant, touches_below = below.between(low, high)
        majorant, touches_above = above.between(count - 1 - high, count - 1 - low)
        majorant, touches_above = _rotate(majorant), touches_above[:, ::-1]

        touches = (touches_below | touches_above) & (low <= index) & (index <= high)
        apart = np.where(touches, majorant - minorant, -1.0)
        widest = apart.argmax(1)[:, None]
        inner_low = np.take_along_axis(_latest(touches_below, index), widest, 1)
        inner_high = np.take_along_axis(_next(touches_above, index), widest, 1)

        # Strictly outside the interval: the mode, with an atom, can be at an end.
        left = (low <= index) & (x < np.take_along_axis(x, inner_low, 1))
        right = (index <= high) & (x > np.take_along_axis(x, inner_high, 1))
        outside = np.where(left, at - minorant, 0) + np.where(right, majorant - before, 0)
        twice = np.maximum(twice, outside.max(1))
        if np.array_equal(low, inner_low) and np.array_equal(high, inner_high):
            return twice / 2
        low, high = inner_low, inner_high


class _Minorant:
    """Greatest convex minorants of points (x, y) [S, K] over intervals of x."""

    def __init__(self, x: Doubles, y: Doubles) -> None:
        self.x, self.y = x, y
        # The last piece of the minorant of points 0 … j is the steepest line to point j.
        self.previous = np.zeros(x.shape, np.intp)
        for j in range(1, x.shape[1]):
            run, rise = x[:, j, None] - x[:, :j], y[:, j, None] - y[:, :j]
            slope = np.full(run.shape, -np.inf)
            np.divide(rise, run, out=slope, where=run > 0)
            self.previous[:, j] = slope.argmax(1)

    def between(self, low: Indices, high: Indices) -> tuple[Doubles, Booleans]:
        """Values of the minorant over x[low] … x[high], and where it touches the points.

        Both results are [S, K]. Values outside the interval are undefined. The minorant of all
        points up to `high` must touch the point `low`.

        Args:
            low: [S, 1].
            high: [S, 1].
        """
        touches = np.zeros(self.x.shape, bool)
        knot = high
        np.put_along_axis(touches, high, True, 1)
        while (knot > low).any():
            # Rounding can lead to a line that skips `low`.
            knot = np.maximum(np.take_along_axis(self.previous, knot, 1), low)
            np.put_along_axis(touches, knot, True, 1)
        index = np.arange(self.x.shape[1])
        start, stop = _latest(touches, index), _next(touches, index)
        x0, x1 = (np.take_along_axis(self.x, i, 1) for i in (start, stop))
        y0, y1 = (np.take_along_axis(self.y, i, 1) for i in (start, stop))
        share = (self.x - x0) / np.where(x1 > x0, x1 - x0, 1)
        return y0 + share * (y1 - y0), touches


def _rotate(values: Doubles) -> Doubles:
    """Rotated by 180°: a least concave majorant becomes a greatest convex minorant."""
    return -values[:, ::-1]


def _latest(mask: Booleans, index: Indices) -> Indices:
    """The last index, up to each index, at which the mask [S, K] is true; 0 if there is none."""
    return np.maximum.accumulate(np.where(mask, index, 0), axis=1)


def _next(mask: Booleans, index: Indices) -> Indices:
    """The first index, from each index on, at which the mask [S, K] is true; else the last one."""
    marked = np.where(mask, index, index[-1])
    return np.minimum.accumulate(marked[:, ::-1], axis=1)[:, ::-1]
