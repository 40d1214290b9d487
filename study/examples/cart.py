"""Tutorial, part one: an environment. A cart with an unobserved mass is pushed to a target.

An environment joins the study by the decorator `register`. It needs no change of the study's code:
``--plugins '[study.examples.cart]'`` imports this file.
"""

import mujoco
import numpy as np

from study.common.arrays import Doubles, Floats
from study.common.seeds import Seeds
from study.data.symmetries import Mirror, Symmetries
from study.envs import Episode, Policy, Scenarios, Simulator, Variable, register

SCENE = """
<mujoco><worldbody><geom type="plane" size="5 5 .1"/>
<body name="cart"><joint type="slide" axis="1 0 0"/><geom type="sphere" size=".1" mass="1"/></body>
</worldbody></mujoco>
"""


@register("cart")
class Cart(Simulator):
    """A cart on a straight track is pushed to a target.

    The cart is a double integrator. A Gaussian force disturbs it at each control step. Its mass is
    not observed, and differs from trajectory to trajectory.
    """

    # These tables name every number that a model, a file or a figure holds: name, unit, meaning
    # and the bounds, if any.
    name, title = "cart", "Cart"
    state = (Variable("x", "m", "position"), Variable("v", "m/s", "velocity"))
    action = (Variable("force", "N", "push", -1.0, 1.0),)
    unobserved = (Variable("mass", "kg", "mass", 0.5, 1.5),)
    goal = (Variable("target", "m", "position that the cart has to reach"),)
    default_horizon = 20
    control_step = 0.1
    radius = 0.2  # The goal is reached within this distance of the target.
    # Left and right are alike, so models may train on mirrored trajectories (`train.symmetries`).
    symmetries = Symmetries(mirror=Mirror(states=("x", "v"), actions=("force",), goal=("target",)))

    def sample_scenarios(self, seeds: Seeds) -> Scenarios:
        # A generator for each seed: a scenario must not depend on the other ones.
        rows = [np.random.default_rng(seed).uniform(-1, 1, 3) for seed in seeds]
        uniform = np.stack(rows).astype(np.float32)
        return Scenarios(s0=uniform[:, :2], goal=uniform[:, 2:])

    def start_episode(
        self, s0: Floats, seeds: Seeds | None = None, noise_steps: int = 1
    ) -> Episode:
        return CartEpisode(s0, seeds, self.control_step)

    def policy(self, scenarios: Scenarios, seeds: Seeds) -> Policy:
        # A spring and a damper. The study plans with it on the noise-free system, clips the
        # actions to their bounds, and executes them open loop on the noisy system.
        return lambda t, states: 2 * (scenarios.goal - states[:, :1]) - 2 * states[:, 1:]

    # The outcome "reaches the target" compares these two positions, [..., 3] in metres.

    def position(self, states: Floats) -> Floats:
        level = np.zeros((*states.shape[:-1], 2), np.float32)
        return np.concatenate([states[..., :1], level], axis=-1)

    def target(self, goal: Floats) -> Floats:
        return self.position(goal)

    # Recordings and pictures show this MuJoCo model. The dynamics need not come from MuJoCo.

    def scene(self) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(SCENE)

    def configuration(self, states: Floats) -> Doubles:
        return states[..., :1].astype(np.float64)


class CartEpisode(Episode):
    """N carts, each with its own mass and noise."""

    def __init__(self, s0: Floats, seeds: Seeds | None, control_step: float) -> None:
        self.states, self.control_step = s0.astype(np.float64), control_step
        self.generators: list[np.random.Generator] = []
        mass = np.ones(len(s0))  # Without seeds: the nominal system, with the mean mass.
        if seeds is not None:
            # Not the stream of the scenario, so that noise and scenario are independent.
            self.generators = [np.random.default_rng([int(seed), 1]) for seed in seeds]
            mass = np.array([generator.uniform(0.5, 1.5) for generator in self.generators])
        self.unobserved = mass.astype(np.float32)[:, None]

    def step(self, actions: Floats) -> Floats:
        force = actions[:, 0].astype(np.float64)
        if self.generators:
            force += [0.2 * generator.normal() for generator in self.generators]
        x, v = self.states.T
        v = v + self.control_step * force / self.unobserved[:, 0]
        x = x + self.control_step * v
        self.states = np.stack([x, v], axis=-1)
        return self.states.astype(np.float32)
