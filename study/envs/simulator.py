"""The contract of a real system: what the study asks of an environment, and nothing more.

A simulator is batched and holds no state. Everything random in a scenario or a rollout comes from
a seed of its own, so the result is the same for any batch size, order and number of threads.

The life of a scenario::

    scenarios = simulator.sample_scenarios(seeds)                    # s0 [N, D] and goal [N, G]
    actions = simulator.plan(scenarios, seeds)           # [N, T, A], on the nominal system
    rollout = simulator.rollout(s0, actions, seeds)      # states [N, T+1, D], with noise
    outcome = simulator.outcome(rollout.states[:, 1:], goal)   # [N] bool

Actions are open loop: planned on the noise-free system, then executed in the noisy one. So they
tell a model nothing about the noise to come, and re-simulating the same s0 and actions with other
seeds (the *oracle*) gives the exact distribution p(s_{1:T} | s_0; a_{0:T-1}) of equation (2).

Underneath, `start` begins an `Episode`, which advances by one control step at a time. `plan`,
`rollout` and the Gymnasium environment (`study.envs.gymnasium_env`) are all made of it.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from study.common.arrays import Booleans, Doubles, Floats
from study.common.registry import Registry
from study.common.seeds import Seeds

Policy = Callable[[int, Floats], NDArray[np.floating]]
"""Actions [N, A], not yet bounded, at control step t in states [N, D]."""


@dataclass(frozen=True)
class Variable:
    """One component of a vector: its name, SI unit, meaning and bounds."""

    name: str
    unit: str
    meaning: str
    low: float = -np.inf
    high: float = np.inf


def bounds(variables: tuple[Variable, ...]) -> tuple[Doubles, Doubles]:
    """The low and the high bounds, [len(variables)] each."""
    low, high = np.array([(v.low, v.high) for v in variables], np.float64).reshape(-1, 2).T
    return low, high


@dataclass(frozen=True)
class Scenarios:
    """N beginnings: s0 [N, D] float32, and goal [N, G] float32, what the agent is asked to do.

    No model sees the goal: it enters the plan, and the outcome.
    """

    s0: Floats
    goal: Floats

    def __getitem__(self, part: slice) -> "Scenarios":
        """Some of the scenarios."""
        return Scenarios(self.s0[part], self.goal[part])


@dataclass(frozen=True)
class Rollout:
    """N trajectories: states [N, T+1, D] float32 (states[:, 0] is s0), unobserved [N, H] float32."""

    states: Floats
    unobserved: Floats


class Episode(ABC):
    """N trajectories under way, each with noise and unobserved variables of its own.

    Attributes:
        unobserved: [N, H] float32.
    """

    unobserved: Floats

    @abstractmethod
    def step(self, actions: Floats) -> Floats:
        """Hold `actions` [N, A], within their bounds, for a control step; states [N, D] after."""


class Simulator(ABC):
    """A real system. Subclasses are registered: ``@register("pusher")``.

    Args:
        horizon: number of control steps T; the environment's own if None.
        threads: CPU threads for the physics. Results do not depend on it.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    """As people write it: Gymnasium's id is ``study/{title}-v0``."""
    # Part of every artifact's key: raise it whenever the numbers that a rollout gives change.
    version: ClassVar[int]
    state: ClassVar[tuple[Variable, ...]]
    action: ClassVar[tuple[Variable, ...]]
    unobserved: ClassVar[tuple[Variable, ...]] = ()
    goal: ClassVar[tuple[Variable, ...]]
    scenario_variables: ClassVar[tuple[Variable, ...]] = ()
    """What scenarios are drawn from, each uniform between its bounds."""
    plotted: ClassVar[tuple[str, ...]] = ()
    """Names of the state variables that a picture should show over time; none: it chooses."""
    rotating_pairs: ClassVar[tuple[tuple[str, str, str], ...]] = ()
    """Pairs of state variables that are components along axes turned by an angle, and that angle:
    models work on them in axes that stand still (`study.data.frames`)."""
    default_horizon: ClassVar[int]
    control_step: ClassVar[float]
    """Seconds from one state of a trajectory to the next."""
    radius: ClassVar[float]
    """Metres: the goal succeeds when `position` comes this close to `target`."""
    at_once: ClassVar[int] = 2048
    """Trajectories simulated at a time: many enough that an operation's fixed cost vanishes, few
    enough that the arrays fit a cache."""

    def __init__(self, horizon: int | None = None, threads: int = 1) -> None:
        self.horizon = horizon or self.default_horizon
        self.threads = threads

    @abstractmethod
    def sample_scenarios(self, seeds: Seeds) -> Scenarios:
        """Draw one scenario for each seed [N]."""

    @abstractmethod
    def start(self, s0: Floats, seeds: Seeds | None = None, ahead: int = 1) -> Episode:
        """Begin a trajectory from each `s0` [N, D], with a seed [N] each.

        Args:
            s0: [N, D].
            seeds: [N]; none: the nominal system, with no noise and unobserved variables at their mean.
            ahead: control steps for which noise may be drawn at once. It changes speed alone.
        """

    @abstractmethod
    def policy(self, scenarios: Scenarios, seeds: Seeds) -> Policy:
        """A policy that tries to do the goal of each scenario [N].

        It may be random (variety to train on): it draws from `seeds` [N].
        """

    @abstractmethod
    def position(self, states: Floats) -> Floats:
        """Where the thing that the goal is about is, [..., 3] in metres, from states [..., D]."""

    @abstractmethod
    def target(self, goal: Floats) -> Floats:
        """Where it should come to, [..., 3] in metres, from goal [..., G]."""

    @abstractmethod
    def scene(self) -> mujoco.MjModel:
        """The MuJoCo model, for drawing."""

    @abstractmethod
    def configuration(self, states: Floats) -> Doubles:
        """MuJoCo's qpos [..., nq] of states [..., D], for drawing."""

    def events(self, states: Floats) -> dict[str, Booleans]:
        """What can happen on the way, and whether it did: [...] of states [..., T+1, D]."""
        return {}

    def bounded(self, actions: NDArray[np.floating]) -> Floats:
        """Actions [..., A] clipped to their bounds."""
        return np.clip(actions, *bounds(self.action)).astype(np.float32)

    def plan(self, scenarios: Scenarios, seeds: Seeds) -> Floats:
        """Actions [N, T, A] of `policy` in closed loop with the nominal system."""
        actions = np.empty((len(seeds), self.horizon, len(self.action)), np.float32)
        for part in self._parts(len(seeds)):
            policy, states = self.policy(scenarios[part], seeds[part]), scenarios.s0[part]
            episode = self.start(states)
            for t in range(self.horizon):
                actions[part, t] = self.bounded(policy(t, states))
                states = episode.step(actions[part, t])
        return actions

    def rollout(self, s0: Floats, actions: Floats, seeds: Seeds | None = None) -> Rollout:
        """Execute `actions` [N, T, A], clipped to their bounds, open loop from `s0` [N, D].

        With a seed [N] a trajectory; without, on the nominal system.
        """
        count, horizon = actions.shape[:2]
        states = np.empty((count, horizon + 1, len(self.state)), np.float32)
        unobserved = np.empty((count, len(self.unobserved)), np.float32)
        states[:, 0] = s0
        for part in self._parts(count):
            own_seeds = None if seeds is None else seeds[part]
            episode = self.start(states[part, 0], own_seeds, ahead=horizon)
            unobserved[part] = episode.unobserved
            commands = self.bounded(actions[part])
            for t in range(horizon):
                states[part, t + 1] = episode.step(commands[:, t])
        return Rollout(states, unobserved)

    def reached(self, states: Floats, goal: Floats) -> Booleans:
        """Whether the goal has succeeded by each step [..., T]: states [..., T, D], goal [..., G].

        `goal` broadcasts against the leading axes of `states`. A state that is not finite is never
        close to anything.
        """
        distance = np.linalg.norm(self.position(states) - self.target(goal)[..., None, :], axis=-1)
        return np.logical_or.accumulate(distance <= self.radius, axis=-1)

    def outcome(self, states: Floats, goal: Floats) -> Booleans:
        """Whether the goal succeeds within the horizon, [...]; arguments as of `reached`."""
        return np.asarray(self.reached(states, goal).any(axis=-1))

    def outcomes(self, states: Floats, goal: Floats) -> dict[str, Booleans]:
        """All that is asked of a trajectory, by name, the goal itself first: [...] each.

        Arguments as of `reached`. A state that is not finite is never where it should be.
        """
        return {"reaches the target": self.outcome(states, goal)}

    def _parts(self, count: int) -> list[slice]:
        return [slice(start, start + self.at_once) for start in range(0, count, self.at_once)]


simulators: Registry[type[Simulator]] = Registry("environment")
