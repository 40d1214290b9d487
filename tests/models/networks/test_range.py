"""Untrained rollouts are finite within the range of the training states, and not beyond it."""

from typing import Any

import pytest
import torch
from torch import Tensor

from study.common.progress import Progress
from study.config.settings import Config
from study.data.normalization import Normalization
from study.data.trajectories import Trajectories, concatenate
from study.envs import simulators
from study.envs.observe import observe_trajectories
from study.models.checkpoints import build, class_of
from study.models.unroll import kernel

STEPS = 60


@pytest.fixture(scope="module")
def flights() -> Trajectories:
    simulator = simulators["uav"](horizon=STEPS)
    return concatenate(observe_trajectories(simulator, 6, 0, Progress()))


def gradient(flights: Trajectories, has_range: bool) -> Tensor:
    """The gradient of the loss of rollouts, of a full CRPS model with initial weights."""
    units = Normalization.from_trajectories(flights)
    torch.manual_seed(0)
    settings = class_of("full_crps").settings_from(Config(), "full_crps")
    network: Any = build("full_crps", units, settings, None, None)
    states = units.normalize_states(flights.states)
    actions = units.normalize_actions(flights.actions)
    if has_range:
        network.on_training_data(states)
    baselines = network.baselines(states[:, 0], actions, None)
    network.rollout_losses(states, actions, baselines)["loss"].backward()
    return torch.cat([p.grad.flatten() for p in network.parameters() if p.grad is not None])


@pytest.mark.parametrize("compiled", [True, False])
def test_rollouts_need_the_range(
    compiled: bool, flights: Trajectories, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A step is quadratic in the state, so a state beyond the range is squared at every step."""
    if not compiled:
        monkeypatch.setattr(kernel, "library", lambda: None)
    assert not gradient(flights, has_range=False).isfinite().all()
    assert gradient(flights, has_range=True).isfinite().all()
