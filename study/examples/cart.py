"""An environment and a model of one's own, in one file: `--plugins '[study.examples.cart]'`."""

from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor, nn

from study.common.arrays import Doubles, Floats
from study.common.seeds import Seeds
from study.envs import Episode, Policy, Scenarios, Simulator, Variable, register
from study.models import Model, models

SCENE = """
<mujoco><worldbody><geom type="plane" size="5 5 .1"/>
<body name="cart"><joint type="slide" axis="1 0 0"/><geom type="sphere" size=".1" mass="1"/></body>
</worldbody></mujoco>
"""


@register("cart")
class Cart(Simulator):
    """A double integrator with a unobserved mass, pushed towards a target."""

    name = "cart"
    title = "Cart"
    version = 1
    state = (Variable("x", "m", "position"), Variable("v", "m/s", "velocity"))
    action = (Variable("force", "N", "push", -1.0, 1.0),)
    unobserved = (Variable("mass", "kg", "mass", 0.5, 1.5),)
    goal = (Variable("target", "m", "where to go"),)
    default_horizon = 20
    control_step = 0.1
    radius = 0.2

    def sample_scenarios(self, seeds: Seeds) -> Scenarios:
        drawn = np.stack([np.random.default_rng(seed).uniform(-1, 1, 3) for seed in seeds])
        return Scenarios(drawn[:, :2].astype(np.float32), drawn[:, 2:].astype(np.float32))

    def start(self, s0: Floats, seeds: Seeds | None = None, ahead: int = 1) -> Episode:
        return Ride(self.control_step, s0, seeds)

    def policy(self, scenarios: Scenarios, seeds: Seeds) -> Policy:
        return lambda t, states: 2 * (scenarios.goal - states[:, :1]) - 2 * states[:, 1:]

    def position(self, states: Floats) -> Floats:
        return np.concatenate([states[..., :1], np.zeros((*states.shape[:-1], 2))], -1).astype(
            np.float32
        )

    def target(self, goal: Floats) -> Floats:
        return self.position(goal)

    def scene(self) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(SCENE)

    def configuration(self, states: Floats) -> Doubles:
        return states[..., :1].astype(np.float64)


class Ride(Episode):
    """N carts on their way."""

    def __init__(self, control_step: float, s0: Floats, seeds: Seeds | None) -> None:
        self.control_step, self.states = control_step, s0.astype(np.float64)
        self.generators = [
            np.random.default_rng([int(seed), 1]) for seed in (() if seeds is None else seeds)
        ]
        mass = [generator.uniform(0.5, 1.5) for generator in self.generators] or np.ones(len(s0))
        self.unobserved = np.array(mass, np.float32)[:, None]

    def step(self, actions: Floats) -> Floats:
        force = actions[:, 0].astype(np.float64)
        if self.generators:
            force += [0.2 * generator.normal() for generator in self.generators]
        speed = self.states[:, 1] + self.control_step * force / self.unobserved[:, 0]
        self.states = np.stack([self.states[:, 0] + self.control_step * speed, speed], -1)
        return self.states.astype(np.float32)


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
