"""Normalised units: learned models work on states and actions of zero mean and unit variance."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from study.common.arrays import Floats, Integers
from study.data.frames import rotating_pairs_of, to_fixed_frame
from study.data.moments import moments
from study.data.trajectories import Trajectories
from study.data.transformations import NO_PAIRS, SymmetryGroup, orbit_parts

SMALLEST_SCALE = 1e-6
"""A component with a smaller standard deviation is constant. Its scale is one."""
CHUNK = 1000
"""Trajectories in memory at a time."""


@dataclass(frozen=True)
class Normalization:
    """Means and standard deviations over all trajectories and steps of a training set.

    Rotating pairs are changed to the fixed frame before they are normalised.

    Attributes:
        state_mean: [D] float32, SI units.
        state_scale: [D] float32, standard deviations of the states, SI units.
        action_mean: [A] float32, SI units.
        action_scale: [A] float32, standard deviations of the actions, SI units.
        delta_std: [D] float32, standard deviations of s_{t+1} − s_t in normalised units.
        rotating_pairs: [P, 3] int64, see `study.data.frames`.
        turned_pairs: [Q, 2] int64, columns of the pairs that a turn of `axis` turns; empty without.
        axis: [2, 2] int64, columns of the points between which the axis of the canonical frame is
            (`study.data.symmetries.Turn`); empty without one, or without symmetries. The moments
            of all transformed copies do not depend on direction: the means of a pair are zero, and
            its scales are equal.
    """

    state_mean: Floats
    state_scale: Floats
    action_mean: Floats
    action_scale: Floats
    delta_std: Floats
    rotating_pairs: Integers
    turned_pairs: Integers
    axis: Integers

    @classmethod
    def from_trajectories(
        cls, trajectories: Trajectories, group: SymmetryGroup | None = None
    ) -> "Normalization":
        """The moments of a training set.

        Args:
            trajectories: the training set.
            group: symmetries. With them, the moments are those of all transformed copies.
        """
        pairs = rotating_pairs_of(trajectories.facts)

        def states() -> Iterable[Floats]:
            for part, _ in _parts(trajectories, group):
                yield to_fixed_frame(_copy(part), torch.from_numpy(pairs)).numpy()

        state_mean, state_scale = _measure(states)
        action_mean, action_scale = _measure(
            lambda: (actions for _, actions in _parts(trajectories, group))
        )
        _, delta_std = _measure(lambda: (np.diff(part, axis=1) / state_scale for part in states()))
        turned, axis = (NO_PAIRS, NO_PAIRS) if group is None else group.canonical_frame()
        return cls(
            state_mean, state_scale, action_mean, action_scale, delta_std, pairs, turned, axis
        )

    def normalize_states(self, states: Floats) -> Tensor:
        """States [..., D] in SI units to normalised units, in the fixed frame."""
        fixed = to_fixed_frame(_copy(states), torch.from_numpy(self.rotating_pairs))
        return _normalize(fixed, self.state_mean, self.state_scale)

    def normalize_actions(self, actions: Floats) -> Tensor:
        """Actions [..., A] in SI units to normalised units."""
        return _normalize(_copy(actions), self.action_mean, self.action_scale)


def _copy(values: Floats) -> Tensor:
    return torch.from_numpy(np.array(values))


def _normalize(values: Tensor, mean: Floats, scale: Floats) -> Tensor:
    # In place, so that memory holds a large data set only once.
    return values.sub_(torch.from_numpy(mean)).div_(torch.from_numpy(scale))


def _parts(
    trajectories: Trajectories, group: SymmetryGroup | None
) -> Iterable[tuple[Floats, Floats]]:
    """States and actions, in parts that fit into memory."""
    if group is not None:
        return orbit_parts(trajectories, group, CHUNK)
    starts = range(0, len(trajectories), CHUNK)
    states, actions = trajectories.states, trajectories.actions
    return ((states[first : first + CHUNK], actions[first : first + CHUNK]) for first in starts)


def _measure(read_parts: Callable[[], Iterable[Floats]]) -> tuple[Floats, Floats]:
    """Mean [D] and scale [D] of an array [N, T, D] that is read part by part."""
    mean, scale = moments(read_parts)
    return mean.astype(np.float32), np.where(scale < SMALLEST_SCALE, 1.0, scale).astype(np.float32)
