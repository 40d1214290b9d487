"""The contract of a real system: what the study asks of an environment, and nothing more.

A simulator is batched and stateless. Everything random in a scenario or a rollout comes from a
seed of its own, so the result is the same for any batch size, order and number of threads.

The life of a scenario::

    scenarios = simulator.draw(seeds)                    # s0 [N, D] and task [N, G]
    actions = simulator.plan(scenarios, seeds)           # [N, T, A], on the nominal system
    rollout = simulator.rollout(s0, actions, seeds)      # states [N, T+1, D], with noise
    outcome = simulator.outcome(rollout.states[:, 1:], task)   # [N] bool

Actions are open loop: planned on the noise-free system, then executed in the noisy one. So they
tell a model nothing about the noise to come, and re-simulating the same s0 and actions with other
seeds (the *oracle*) gives the exact distribution p(s_{1:T} | s_0; a_{0:T-1}) of equation (2).
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from study.registry import Registry
from study.seeds import Seeds

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Booleans = NDArray[np.bool_]


@dataclass(frozen=True)
class Variable:
    """One component of a vector: its name, SI unit, meaning and bounds."""

    name: str
    unit: str
    meaning: str
    low: float = -np.inf
    high: float = np.inf


@dataclass(frozen=True)
class Scenarios:
    """N beginnings: s0 [N, D] float32, and task [N, G] float32, what the agent is asked to do.

    No model sees the task: it enters the plan, and the outcome.
    """

    s0: Floats
    task: Floats


@dataclass(frozen=True)
class Rollout:
    """N trajectories: states [N, T+1, D] float32 (states[:, 0] is s0), hidden [N, H] float32."""

    states: Floats
    hidden: Floats


class Simulator(ABC):
    """A real system. Subclasses are registered: ``@simulators.register("pusher")``.

    Args:
        horizon: number of control steps T; the environment's own if None.
        threads: CPU threads for the physics. Results do not depend on it.
    """

    name: ClassVar[str]
    # Part of every artifact's key: raise it whenever the numbers that a rollout gives change.
    version: ClassVar[int]
    state: ClassVar[tuple[Variable, ...]]
    action: ClassVar[tuple[Variable, ...]]
    hidden: ClassVar[tuple[Variable, ...]]
    task: ClassVar[tuple[Variable, ...]]
    default_horizon: ClassVar[int]
    control_step: ClassVar[float]
    """Seconds from one state of a trajectory to the next."""
    radius: ClassVar[float]
    """Metres: the task succeeds when `position` comes this close to `target`."""

    def __init__(self, horizon: int | None = None, threads: int = 1) -> None:
        self.horizon = horizon or self.default_horizon
        self.threads = threads

    @abstractmethod
    def draw(self, seeds: Seeds) -> Scenarios:
        """Draw one scenario for each seed [N]."""

    @abstractmethod
    def plan(self, scenarios: Scenarios, seeds: Seeds) -> Floats:
        """Actions [N, T, A] of a policy that tries to do the task on the noise-free system.

        The policy may be random (variety to train on): it draws from `seeds` [N].
        """

    @abstractmethod
    def rollout(self, s0: Floats, actions: Floats, seeds: Seeds, noise: bool = True) -> Rollout:
        """Execute `actions` [N, T, A] open loop from `s0` [N, D], one seed [N] a trajectory.

        With `noise=False` the nominal system: no noise, hidden variables at their mean.
        """

    @abstractmethod
    def position(self, states: Floats) -> Floats:
        """Where the thing that the task is about is, [..., 3] in metres, from states [..., D]."""

    @abstractmethod
    def target(self, task: Floats) -> Floats:
        """Where it should come to, [..., 3] in metres, from task [..., G]."""

    @abstractmethod
    def scene(self) -> mujoco.MjModel:
        """The MuJoCo model, for drawing."""

    @abstractmethod
    def configuration(self, states: Floats) -> Doubles:
        """MuJoCo's qpos [..., nq] of states [..., D], for drawing."""

    def outcome(self, states: Floats, task: Floats) -> Booleans:
        """Whether the task succeeds within the horizon: [...] of states [..., T, D], task [..., G].

        `task` broadcasts against the leading axes of `states`. A state that is not finite is never
        close to anything.
        """
        distance = np.linalg.norm(self.position(states) - self.target(task)[..., None, :], axis=-1)
        return np.asarray((distance <= self.radius).any(axis=-1))


simulators: Registry[type[Simulator]] = Registry("environment")
