"""Standard units: every learned model works on states and actions of zero mean and unit scale."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from study.data.trajectories import Trajectories

Floats = NDArray[np.float32]

# A component that does not vary (a constant wind, say) is left in its own units.
SMALLEST_SCALE = 1e-6


@dataclass(frozen=True)
class Scaling:
    """Means and standard deviations over all trajectories and steps of a training set.

    Attributes:
        state_mean, state_scale: [D] float32.
        action_mean, action_scale: [A] float32.
        change_scale: [D] float32, standard deviation of s_{t+1} − s_t in standard units.
    """

    state_mean: Floats
    state_scale: Floats
    action_mean: Floats
    action_scale: Floats
    change_scale: Floats

    @classmethod
    def of(cls, trajectories: Trajectories) -> "Scaling":
        """Measure a training set."""
        states, actions = trajectories.states, trajectories.actions
        state_scale = _scale(states)
        changes = np.diff(states, axis=1) / state_scale
        return cls(_mean(states), state_scale, _mean(actions), _scale(actions), _scale(changes))

    def standard_states(self, states: Floats) -> Tensor:
        """[..., D] in SI units to standard units."""
        return torch.from_numpy((states - self.state_mean) / self.state_scale)

    def standard_actions(self, actions: Floats) -> Tensor:
        """[..., A] in SI units to standard units."""
        return torch.from_numpy((actions - self.action_mean) / self.action_scale)


def _mean(values: Floats) -> Floats:
    return values.mean(axis=(0, 1), dtype=np.float64).astype(np.float32)


def _scale(values: Floats) -> Floats:
    scale = values.std(axis=(0, 1), dtype=np.float64)
    return np.where(scale < SMALLEST_SCALE, 1.0, scale).astype(np.float32)
