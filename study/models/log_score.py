"""The log score of forecasters that have a density: the negative log-density of what was observed.

A forecaster has a density if its class has a method `log_density`. The others are known by their
samples alone. A density estimated from samples would depend on the estimator, and is left out.
"""

from typing import Protocol, runtime_checkable

import numpy as np
import torch
from torch import Tensor

from study.common.arrays import Doubles
from study.data.trajectories import ScenarioSet
from study.models.base import Forecaster, Model


@runtime_checkable
class HasDensity(Protocol):
    """A model whose density is known."""

    def log_density(self, states: Tensor, actions: Tensor) -> Tensor:
        """log p(s_{t+1} | s_{0:t}; a_{0:t}) for t = 0 … T−1, [S, T], in normalised units.

        Args:
            states: observed states s_{0:T} [S, T+1, D].
            actions: [S, T, A].
        """


@torch.no_grad()
def log_scores(forecaster: Forecaster, test: ScenarioSet) -> Doubles | None:
    """The log score of each step of the first observed rollout; None without a density.

    Each step is divided by D. So the sum over the steps is the negative log-density of the whole
    trajectory, divided by D. States are in standard deviations of the training data.

    Args:
        forecaster: the forecaster.
        test: scenarios.

    Returns:
        [S, T] in nats.
    """
    if not (isinstance(forecaster, Model) and isinstance(forecaster, HasDensity)):
        return None
    states = np.concatenate([test.s0[:, None], test.observed[:, 0]], axis=1)
    inputs = forecaster.normalize(torch.from_numpy(states), torch.from_numpy(test.actions))
    density = forecaster.log_density(*inputs).double().cpu().numpy()
    return np.asarray(-density / states.shape[-1], np.float64)
