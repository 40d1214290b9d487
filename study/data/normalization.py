"""Standard units: every learned model works on states and actions of zero mean and unit scale.

Pairs that an environment names are pairs first (`study.data.frames`)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from study.common.arrays import Floats, Integers
from study.data.frames import rotating_pairs_of, turn
from study.data.moments import moments
from study.data.trajectories import Trajectories

# A component that does not vary (a constant wind, say) is left in its own units.
SMALLEST_SCALE = 1e-6
# Trajectories that are looked at together: bounds the memory.
PART = 1000


@dataclass(frozen=True)
class Normalization:
    """Means and standard deviations over all trajectories and steps of a training set.

    Attributes:
        state_mean, state_scale: [D] float32.
        action_mean, action_scale: [A] float32.
        delta_std: [D] float32, standard deviation of s_{t+1} − s_t in standard units.
        rotating_pairs: [P, 3] int64, the pairs and their angles.
    """

    state_mean: Floats
    state_scale: Floats
    action_mean: Floats
    action_scale: Floats
    delta_std: Floats
    rotating_pairs: Integers

    @classmethod
    def of(cls, trajectories: Trajectories) -> "Normalization":
        """Measure a training set."""
        states, actions = trajectories.states, trajectories.actions
        pairs = rotating_pairs_of(trajectories.facts)

        def level(part: Floats) -> Floats:
            return turn(_copy(part), torch.from_numpy(pairs)).numpy()

        state_mean, state_scale = _measure(states, level)
        action_mean, action_scale = _measure(actions)
        _, delta_std = _measure(states, lambda part: np.diff(level(part), axis=1) / state_scale)
        return cls(state_mean, state_scale, action_mean, action_scale, delta_std, pairs)

    def normalize_states(self, states: Floats) -> Tensor:
        """[..., D] in SI units to standard units."""
        level = turn(_copy(states), torch.from_numpy(self.rotating_pairs))
        return _standard(level, self.state_mean, self.state_scale)

    def normalize_actions(self, actions: Floats) -> Tensor:
        """[..., A] in SI units to standard units."""
        return _standard(_copy(actions), self.action_mean, self.action_scale)


def _copy(values: Floats) -> Tensor:
    return torch.from_numpy(np.array(values))


def _standard(values: Tensor, mean: Floats, scale: Floats) -> Tensor:
    # In place: a large set is in memory once.
    return values.sub_(torch.from_numpy(mean)).div_(torch.from_numpy(scale))


def _measure(
    values: Floats, change: Callable[[Floats], Floats] = lambda part: part
) -> tuple[Floats, Floats]:
    """Mean and scale [D] of values [N, T, D], changed if so asked, part by part."""
    starts = range(0, len(values), PART)
    mean, scale = moments(lambda: (change(values[start : start + PART]) for start in starts))
    return mean.astype(np.float32), np.where(scale < SMALLEST_SCALE, 1.0, scale).astype(np.float32)
