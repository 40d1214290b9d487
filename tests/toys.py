"""An environment and a model of one's own, in one file: `--plugins '[tests.toys]'`."""

from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor, nn

from study.envs import Rollout, Scenarios, Simulator, Variable, simulators
from study.envs.simulator import Doubles, Floats
from study.models import Model, models
from study.seeds import Seeds

SCENE = """
<mujoco><worldbody><geom type="plane" size="5 5 .1"/>
<body name="cart"><joint type="slide" axis="1 0 0"/><geom type="sphere" size=".1" mass="1"/></body>
</worldbody></mujoco>
"""


@simulators.register("cart")
class Cart(Simulator):
    """A double integrator with a hidden mass, pushed towards a target."""

    name = "cart"
    version = 1
    state = (Variable("x", "m", "position"), Variable("v", "m/s", "velocity"))
    action = (Variable("force", "N", "push", -1.0, 1.0),)
    hidden = (Variable("mass", "kg", "mass", 0.5, 1.5),)
    task = (Variable("target", "m", "where to go"),)
    default_horizon = 20
    control_step = 0.1
    radius = 0.2

    def draw(self, seeds: Seeds) -> Scenarios:
        drawn = np.stack([np.random.default_rng(seed).uniform(-1, 1, 3) for seed in seeds])
        return Scenarios(drawn[:, :2].astype(np.float32), drawn[:, 2:].astype(np.float32))

    def plan(self, scenarios: Scenarios, seeds: Seeds) -> Floats:
        states = scenarios.s0.astype(np.float64)
        actions = np.zeros((len(seeds), self.horizon, 1), np.float32)
        for step in range(self.horizon):
            wanted = 2 * (scenarios.task[:, 0] - states[:, 0]) - 2 * states[:, 1]
            actions[:, step, 0] = np.clip(wanted, -1, 1)
            states = self._step(states, actions[:, step, 0], 1.0, 0.0)
        return actions

    def rollout(self, s0: Floats, actions: Floats, seeds: Seeds, noise: bool = True) -> Rollout:
        generators = [np.random.default_rng([int(seed), 1]) for seed in seeds]
        mass = np.array([g.uniform(0.5, 1.5) for g in generators]) if noise else 1.0
        pushes = np.stack([g.normal(size=actions.shape[1]) for g in generators]) * 0.2 * noise
        states = [s0.astype(np.float64)]
        for step in range(actions.shape[1]):
            states.append(self._step(states[-1], actions[:, step, 0], mass, pushes[:, step]))
        hidden = np.broadcast_to(np.asarray(mass, np.float32), len(seeds))[:, None]
        return Rollout(np.stack(states, 1).astype(np.float32), np.array(hidden))

    def _step(self, states: Doubles, force: Floats, mass: Any, push: Any) -> Doubles:
        speed = states[:, 1] + self.control_step * (force + push) / mass
        return np.stack([states[:, 0] + self.control_step * speed, speed], -1)

    def position(self, states: Floats) -> Floats:
        return np.concatenate([states[..., :1], np.zeros((*states.shape[:-1], 2))], -1).astype(
            np.float32
        )

    def target(self, task: Floats) -> Floats:
        return self.position(task)

    def scene(self) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(SCENE)

    def configuration(self, states: Floats) -> Doubles:
        return states[..., :1].astype(np.float64)


@models.register("drift")
class Drift(Model):
    """Every step changes the state by a learned constant and normal noise."""

    def __init__(self, scaling: Any, settings: dict[str, Any]) -> None:
        super().__init__(scaling, settings)
        self.noise_size = self.state_size
        self.change = nn.Parameter(torch.zeros(self.state_size))
        self.spread = nn.Parameter(torch.full((self.state_size,), 0.1))

    def training_step(self, batch: dict[str, Tensor]) -> Tensor:
        states = batch["states"]
        error = states[:, 1:] - states[:, :-1] - self.change
        loss = error.square().mean() + (error.detach().std() - self.spread).square().mean()
        self.log("loss", loss.detach())
        return loss

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        return s0[:, None, None] + torch.cumsum(self.change + self.spread * noise, dim=2)
