"""Signals that were logged at their own times, at the regular times of control steps."""

import numpy as np

from study.common.arrays import Array, Doubles

TOLERANCE = 1e-6
"""A step that ends later by less than this share of a step is complete."""


def grid(first: float, last: float, step: float) -> Doubles:
    """The times from `first` to `last`, `step` seconds apart, [N]."""
    count = int(np.floor((last - first) / step + TOLERANCE))
    return np.asarray(first + step * np.arange(count + 1), np.float64)


def interpolate(time: Doubles, values: Array, at: Doubles) -> Doubles:
    """Values [n, V] at the times `at` [N], linear between the logged times [n]."""
    columns = [np.interp(at, time, column) for column in values.T]
    return np.stack(columns, axis=1) if columns else np.empty((len(at), 0))


def previous(time: Doubles, values: Array, at: Doubles) -> Array:
    """The last value [n, V] that was logged at or before each of the times `at` [N]."""
    index = np.searchsorted(time, at + TOLERANCE * _step(at), side="right") - 1
    return np.asarray(values[np.maximum(index, 0)])


def mean_of_steps(time: Doubles, values: Array, at: Doubles) -> Doubles:
    """The mean [N, V] of held values over each step from `at` [N] to the next.

    A value [n, V] holds from its time to the next logged time. The mean is that over the time, so
    a command that changes within a step counts for the time that it was held. The last step has no
    end in `at`; it has the value that holds at its start.
    """
    held = np.asarray(values, np.float64)
    duration = np.diff(time)[:, None]
    integral = np.concatenate([np.zeros((1, held.shape[1])), np.cumsum(held[:-1] * duration, 0)])
    start = previous(time, held, at)
    if len(at) < 2:
        return np.asarray(start)
    at_times = interpolate(time, integral, at)
    # np.interp is constant after the last logged time; the last value is held there.
    late = np.maximum(at - time[-1], 0)[:, None]
    at_times = at_times + late * held[-1]
    means = np.diff(at_times, axis=0) / np.diff(at)[:, None]
    return np.concatenate([means, start[-1:]])


def _step(at: Doubles) -> float:
    return float(at[1] - at[0]) if len(at) > 1 else 0.0
