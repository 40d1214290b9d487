"""An environment whose step is bimodal: a puck hops to the left or to the right with probability ½.

No normal p(s_{t+1} | s_t, a_t) describes such a step, so a forecaster needs a latent variable.
``configs/fork.yaml`` compares a VAE that uses its latent variable, a VAE whose posterior collapsed,
and the probabilistic MLP.
"""

import numpy as np

from study.common.arrays import Floats
from study.common.seeds import Seeds
from study.envs import Episode, Policy, Scenarios, Simulator, Variable, register

DAMPING = 0.3
"""Factor on the position at every step. Without damping, the sum of many hops would be nearly
normal. Below ⅓, the two modes of each step stay apart."""

HOP = 1.0
"""Length of a hop, in metres."""

NOISE_STD = 0.05
"""Standard deviation of the noise of a step, in metres."""


@register("fork")
class Fork(Simulator):
    """A puck hops along a line, to a random side at every step.

    A step damps the position and adds the action's push. Then the puck hops one metre to the left
    or to the right, with probability ½ each, and Gaussian noise is added. So the position has two
    modes at every step, whatever the action is.
    """

    name, title = "fork", "Fork"
    state = (Variable("x", "m", "position"),)
    action = (Variable("push", "m", "displacement by the action", -0.2, 0.2),)
    goal = (Variable("target", "m", "position that the puck has to reach"),)
    default_horizon = 20
    control_step = 1.0
    radius = 0.05

    def sample_scenarios(self, seeds: Seeds) -> Scenarios:
        """See `Simulator.sample_scenarios`: a target takes a few hops to the same side."""
        rows = np.stack([np.random.default_rng(seed).uniform(-1, 1, 3) for seed in seeds])
        target = np.sign(rows[:, 1]) * (1.55 + 0.35 * rows[:, 2])
        columns = np.stack([rows[:, 0], target], axis=1).astype(np.float32)
        return Scenarios(s0=columns[:, :1], goal=columns[:, 1:])

    def start_episode(
        self, s0: Floats, seeds: Seeds | None = None, noise_steps: int = 1
    ) -> Episode:
        """See `Simulator.start_episode`. The nominal system neither hops nor has noise."""
        return ForkEpisode(s0, seeds)

    def policy(self, scenarios: Scenarios, seeds: Seeds) -> Policy:
        """See `Simulator.policy`: a random push at each step, which the target biases."""
        pushes = np.stack(
            [np.random.default_rng(seed).uniform(-0.2, 0.2, self.horizon) for seed in seeds]
        )
        return lambda t, states: pushes[:, t : t + 1] + 0.1 * np.sign(scenarios.goal)

    def position(self, states: Floats) -> Floats:
        """See `Simulator.position`."""
        rest = np.zeros((*states.shape[:-1], 2), np.float32)
        return np.concatenate([states, rest], axis=-1)

    def target(self, goal: Floats) -> Floats:
        """See `Simulator.target`."""
        return self.position(goal)


class ForkEpisode(Episode):
    """N pucks, each with its own hops and noise."""

    def __init__(self, s0: Floats, seeds: Seeds | None) -> None:
        self.x = s0[:, 0].astype(np.float64)
        self.generators: list[np.random.Generator] = []
        if seeds is not None:
            # Not the stream of the scenario, so that noise and scenario are independent.
            self.generators = [np.random.default_rng([int(seed), 1]) for seed in seeds]
        self.unobserved = np.zeros((len(s0), 0), np.float32)

    def step(self, actions: Floats) -> Floats:
        """See `Episode.step`."""
        self.x = DAMPING * self.x + actions[:, 0]
        for index, generator in enumerate(self.generators):
            side = 1 if generator.random() < 0.5 else -1
            self.x[index] += side * HOP + NOISE_STD * generator.normal()
        return self.x[:, None].astype(np.float32)
