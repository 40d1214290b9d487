"""The contract of a real system: all that the study asks of an environment.

A simulator is batched and has no state. All randomness of a scenario or a rollout comes from that
scenario's or rollout's seed. So the result is the same for any batch size, order and number of
threads.

From a seed to an outcome::

    scenarios = simulator.sample_scenarios(seeds)              # s0 [N, D] and goal [N, G]
    actions = simulator.plan(scenarios, seeds)                 # [N, T, A], on the nominal system
    rollout = simulator.rollout(scenarios.s0, actions, seeds)  # states [N, T+1, D], with noise
    outcome = simulator.outcome(rollout.states[:, 1:], scenarios.goal)  # [N] bool

Actions are open loop: they are planned on the noise-free system and executed in the noisy one. So
they carry no information about the noise. Simulating the same s0 and actions with other seeds (the
*oracle*) therefore samples the exact distribution p(s_{1:T} | s_0; a_{0:T-1}) of equation (2).

`start_episode` begins an `Episode`, which advances by one control step at a time. `plan`, `rollout`
and the Gymnasium environment (`study.envs.gymnasium_env`) all step episodes.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from study.common.arrays import Booleans, Doubles, Floats
from study.common.errors import BadInput
from study.common.registry import Registry
from study.common.seeds import Seeds
from study.data.symmetries import Symmetries
from study.data.variables import Constant, Variable, bounds

Policy = Callable[[int, Floats], NDArray[np.floating]]
"""Unclipped actions [N, A] for control step t and states [N, D]."""


@dataclass(frozen=True)
class Scenarios:
    """N initial states, each with a goal. No model sees the goal.

    Attributes:
        s0: [N, D] float32, SI units.
        goal: [N, G] float32, SI units. The policy and the outcome depend on it.
    """

    s0: Floats
    goal: Floats

    def __getitem__(self, index: slice) -> "Scenarios":
        """Some of the scenarios."""
        return Scenarios(self.s0[index], self.goal[index])


@dataclass(frozen=True)
class Rollout:
    """N simulated trajectories.

    Attributes:
        states: [N, T+1, D] float32, SI units; ``states[:, 0]`` is s_0.
        unobserved: [N, H] float32, SI units.
    """

    states: Floats
    unobserved: Floats


class Episode(ABC):
    """N trajectories in progress, each with its own noise and unobserved variables.

    Attributes:
        unobserved: [N, H] float32, SI units.
    """

    unobserved: Floats

    @abstractmethod
    def step(self, actions: Floats) -> Floats:
        """Hold the actions for one control step.

        Args:
            actions: [N, A], within their bounds.

        Returns:
            The states [N, D] after the step.
        """


class Simulator(ABC):
    """A real system. A subclass joins the study by ``@register("pusher")``.

    The docstring of a subclass describes the system on its page (`study.envs.card`). The page takes
    names, units and numbers from the attributes below.

    Args:
        horizon: number of control steps T; None is the system's own.
        threads: CPU threads for the physics. Results do not depend on it.
    """

    name: ClassVar[str]
    """The registered name."""
    title: ClassVar[str]
    """The name in text. Gymnasium's id is ``study/{title}-v0``."""
    version: ClassVar[int] = 1
    """Version of the data sets that `export` writes. Raise it when the numbers of a rollout change.
    (The study itself notices a change of the source.)"""
    state: ClassVar[tuple[Variable, ...]]
    action: ClassVar[tuple[Variable, ...]]
    """Their bounds are finite."""
    unobserved: ClassVar[tuple[Variable, ...]] = ()
    """Variables that act on a trajectory and that no model sees."""
    goal: ClassVar[tuple[Variable, ...]]
    scenario_variables: ClassVar[tuple[Variable, ...]] = ()
    """What a scenario is sampled from, uniformly between the bounds."""
    scenario_conditions: ClassVar[tuple[Variable, ...]] = ()
    """Quantities of a scenario. One outside of these bounds is rejected and sampled anew."""
    policy_variables: ClassVar[tuple[Variable, ...]] = ()
    """Parameters of the policy, sampled for each trajectory, uniformly between the bounds."""
    plotted: ClassVar[tuple[str, ...]] = ()
    """Names of the state variables that figures plot over time; empty: the figure chooses."""
    rotating_pairs: ClassVar[tuple[tuple[str, str, str], ...]] = ()
    """Names (a, b, angle) of state variables: a and b are components along axes that are rotated
    by the angle. Models see them in a fixed frame (`study.data.frames`)."""
    symmetries: ClassVar[Symmetries] = Symmetries()
    """The transformations that map a rollout onto another one; without any, the trivial group. The
    setting `train.symmetries` applies them to training data (`study.data.symmetries`)."""
    default_horizon: ClassVar[int]
    control_step: ClassVar[float]
    """Seconds from one state of a trajectory to the next."""
    radius: ClassVar[float]
    """Metres. The goal is reached when `position` is this close to `target`."""
    has_position: bool = True
    """Whether recordings draw `position` in space."""
    position_unit: str = "m"
    """The unit of `position`."""
    has_target: bool = True
    """Whether recordings draw `target`."""
    chunk_size: ClassVar[int] = 2048
    """Trajectories that are simulated together. A larger chunk shares the fixed cost of an
    operation among more trajectories; a smaller one fits into the CPU's cache."""

    def __init__(self, horizon: int | None = None, threads: int = 1) -> None:
        self.horizon = self.default_horizon if horizon is None else horizon
        if self.horizon < 1:
            raise BadInput(f"{self.title}: got a horizon of {horizon}; it must be at least 1")
        self.threads = threads

    @abstractmethod
    def sample_scenarios(self, seeds: Seeds) -> Scenarios:
        """One scenario for each seed [N]."""

    @abstractmethod
    def start_episode(
        self, s0: Floats, seeds: Seeds | None = None, noise_steps: int = 1
    ) -> Episode:
        """Begin N trajectories.

        Args:
            s0: [N, D] initial states.
            seeds: [N] seeds of the noise and of the unobserved variables. None is the nominal
                system: no noise, and unobserved variables at their mean.
            noise_steps: control steps whose noise is sampled together. It affects speed only.
        """

    @abstractmethod
    def policy(self, scenarios: Scenarios, seeds: Seeds) -> Policy:
        """A policy that tries to reach the goal of each of N scenarios.

        Args:
            scenarios: N scenarios.
            seeds: [N] seeds of the policy's random parameters, which vary the training data.
        """

    @abstractmethod
    def position(self, states: Floats) -> Floats:
        """Positions [..., 3] in metres of the body that the goal is about; states [..., D]."""

    @abstractmethod
    def target(self, goal: Floats) -> Floats:
        """Positions [..., 3] in metres that this body has to reach; goal [..., G]."""

    def scene(self) -> mujoco.MjModel | None:
        """The MuJoCo model that pictures show. Without one, recordings show paths alone."""
        return None

    def configuration(self, states: Floats) -> Doubles:
        """MuJoCo's qpos [..., nq] in `scene` for states [..., D]; needed where there is a scene."""
        raise NotImplementedError(f"{type(self).__name__} has a scene, but no `configuration`")

    def constants(self) -> tuple[Constant, ...]:
        """The physical constants that the system's page lists."""
        return ()

    def events(self, states: Floats) -> dict[str, Booleans]:
        """Which events happen in trajectories with states [..., T+1, D].

        Returns:
            By the name of the event, whether it happens, [...].
        """
        return {}

    def clip_actions(self, actions: NDArray[np.floating]) -> Floats:
        """Actions [..., A] clipped to their bounds, float32."""
        return np.clip(actions, *bounds(self.action)).astype(np.float32)

    def plan(self, scenarios: Scenarios, seeds: Seeds) -> Floats:
        """Actions [N, T, A] of `policy` in closed loop with the nominal system."""
        actions = np.empty((len(seeds), self.horizon, len(self.action)), np.float32)
        for chunk in self._chunks(len(seeds)):
            policy, states = self.policy(scenarios[chunk], seeds[chunk]), scenarios.s0[chunk]
            episode = self.start_episode(states)
            for t in range(self.horizon):
                actions[chunk, t] = self.clip_actions(policy(t, states))
                states = episode.step(actions[chunk, t])
        return actions

    def rollout(self, s0: Floats, actions: Floats, seeds: Seeds | None = None) -> Rollout:
        """Execute actions open loop.

        Args:
            s0: [N, D] initial states.
            actions: [N, T, A]; they are clipped to their bounds.
            seeds: [N] seeds of the noise; None is the nominal system.
        """
        count, horizon = actions.shape[:2]
        states = np.empty((count, horizon + 1, len(self.state)), np.float32)
        unobserved = np.empty((count, len(self.unobserved)), np.float32)
        states[:, 0] = s0
        for chunk in self._chunks(count):
            noise_seeds = None if seeds is None else seeds[chunk]
            episode = self.start_episode(states[chunk, 0], noise_seeds, noise_steps=horizon)
            unobserved[chunk] = episode.unobserved
            clipped = self.clip_actions(actions[chunk])
            for t in range(horizon):
                states[chunk, t + 1] = episode.step(clipped[:, t])
        return Rollout(states, unobserved)

    def reached(self, states: Floats, goal: Floats) -> Booleans:
        """Whether the goal has been reached by each step.

        Args:
            states: [..., T, D]. A state that is not finite does not reach any goal.
            goal: [..., G]; it broadcasts against the leading axes of `states`.

        Returns:
            [..., T]
        """
        distance = np.linalg.norm(self.position(states) - self.target(goal)[..., None, :], axis=-1)
        return np.logical_or.accumulate(distance <= self.radius, axis=-1)

    def outcome(self, states: Floats, goal: Floats) -> Booleans:
        """Whether the goal is reached within the horizon, [...]; arguments as of `reached`."""
        return np.asarray(self.reached(states, goal).any(axis=-1))

    def outcomes(self, states: Floats, goal: Floats) -> dict[str, Booleans]:
        """The binary outcomes that are forecast, by name, [...] each; `outcome` is the first.

        Arguments as of `reached`. A state that is not finite fails every condition on it.
        """
        return {"reaches the target": self.outcome(states, goal)}

    def _chunks(self, count: int) -> list[slice]:
        starts = range(0, count, self.chunk_size)
        return [slice(start, start + self.chunk_size) for start in starts]


simulators: Registry[type[Simulator]] = Registry("environment")
