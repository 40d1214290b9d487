"""The data sets of a simulator: training trajectories, and scenarios with repeated rollouts.

Every trajectory has its own seed, so the first n trajectories do not depend on their number.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np

from study import __version__
from study.common.arrays import Floats
from study.common.errors import StudyError
from study.common.progress import Progress
from study.common.seeds import Seeds, derive, spawn
from study.config.recorded import Recorded
from study.config.settings import Collect
from study.data.trajectories import ScenarioSet, Trajectories
from study.data.variables import Variable, to_json
from study.envs.recorded import RecordedSystem
from study.envs.simulator import Scenarios, Simulator, simulators

CHUNK = 1000
"""Trajectories that are in memory together; progress is reported after each chunk."""


def real_system(
    environment: str, collect: Collect, recorded: Recorded | None = None
) -> tuple[Simulator, int]:
    """The system that the study observes, and the seed of all its data sets.

    Raises:
        BadInput: the environment is unknown.
    """
    simulator = system_of(environment, recorded, collect.horizon)
    return simulator, derive(environment, collect.seed)


def system_of(
    environment: str,
    recorded: Recorded | None = None,
    horizon: int | None = None,
    control_step: float = 0.0,
) -> Simulator:
    """A simulator by its registered name, or a recorded system by its settings.

    Args:
        environment: name of the system.
        recorded: its settings; None for a simulator.
        horizon: number of control steps T; None is the system's own.
        control_step: seconds, of a recorded system whose settings do not give it.

    Raises:
        BadInput: the environment is unknown, or a setting of a recorded system cannot be used.
    """
    if recorded is not None:
        return RecordedSystem(environment, recorded, horizon, control_step)
    return simulators[environment](horizon=horizon)


def observe_training(
    environment: str, collect: Collect, progress: Progress
) -> Iterator[Trajectories]:
    """The training trajectories of an environment, chunk by chunk."""
    simulator, seed = real_system(environment, collect)
    return observe_trajectories(simulator, collect.trajectories, derive(seed, "train"), progress)


def observe_trajectories(
    simulator: Simulator, count: int, seed: int, progress: Progress
) -> Iterator[Trajectories]:
    """`count` trajectories of as many scenarios, chunk by chunk.

    The first n trajectories do not depend on `count`.

    Raises:
        StudyError: a state, an action or a goal is not finite.
    """
    scenario_seeds, noise_seeds = trajectory_seeds(seed, count)
    facts = _facts(simulator, seed)
    for start in range(0, count, CHUNK):
        chunk = slice(start, start + CHUNK)
        scenarios, actions = sample_planned(simulator, scenario_seeds[chunk])
        rollout = simulator.rollout(scenarios.s0, actions, noise_seeds[chunk])
        labels = _Labels(simulator, "training", "trajectory", start)
        labels.check_scenarios(scenarios, actions)
        labels.check(simulator.state, rollout.states, "step")
        labels.check(simulator.unobserved, rollout.unobserved)
        yield Trajectories(rollout.states, actions, scenarios.goal, rollout.unobserved, facts)
        progress(min(1.0, (start + CHUNK) / count), f"{simulator.name}: training trajectories")


def trajectory_seeds(seed: int, count: int) -> tuple[Seeds, Seeds]:
    """The seeds of `count` scenarios [count], and of the noise in each [count].

    The first n seeds do not depend on `count`.
    """
    return spawn(derive(seed, "scenario"), count), spawn(seed, count)


def sample_planned(simulator: Simulator, seeds: Seeds) -> tuple[Scenarios, Floats]:
    """A scenario for each seed [N], and its planned actions [N, T, A]."""
    scenarios = simulator.sample_scenarios(seeds)
    return scenarios, simulator.plan(scenarios, seeds)


def observe_scenarios(
    simulator: Simulator,
    count: int,
    rollouts: int,
    seed: int,
    progress: Progress,
    name: str = "test",
) -> Iterator[ScenarioSet]:
    """`count` scenarios with `rollouts` noisy rollouts each, chunk by chunk.

    Raises:
        StudyError: a state, an action or a goal is not finite; it names the set by `name`.
    """
    scenario_seeds, noise_seeds = trajectory_seeds(seed, count)
    scenarios, actions = sample_planned(simulator, scenario_seeds)
    _Labels(simulator, name, "scenario", 0).check_scenarios(scenarios, actions)
    facts, start = _facts(simulator, seed), 0
    for observed, unobserved in repeat_rollouts(
        simulator, scenarios.s0, actions, rollouts, noise_seeds, progress
    ):
        chunk = slice(start, start + len(observed))
        labels = _Labels(simulator, name, "scenario", start)
        labels.check(simulator.state, observed, "rollout", "step", first_step=1)
        labels.check(simulator.unobserved, unobserved, "rollout")
        s0, goal = scenarios.s0[chunk], scenarios.goal[chunk]
        yield ScenarioSet(s0, actions[chunk], goal, observed, unobserved, facts)
        start += len(observed)


def repeat_rollouts(
    simulator: Simulator,
    s0: Floats,
    actions: Floats,
    rollouts: int,
    seeds: Seeds,
    progress: Progress,
) -> Iterator[tuple[Floats, Floats]]:
    """K rollouts of each of S scenarios, chunk by chunk.

    The noise of a scenario's rollout depends on the scenario's seed and the rollout's number.

    Args:
        simulator: the system.
        s0: [S, D] initial states.
        actions: [S, T, A].
        rollouts: K.
        seeds: [S], one for each scenario.
        progress: called after each chunk.

    Yields:
        For each chunk of scenarios, the states s_1 … s_T [S, K, T, D] and the unobserved variables
        [S, K, H].
    """
    chunk_size = max(1, CHUNK // rollouts)
    for start in range(0, len(s0), chunk_size):
        chunk = slice(start, start + chunk_size)
        rollout = simulator.rollout(
            np.repeat(s0[chunk], rollouts, axis=0),
            np.repeat(actions[chunk], rollouts, axis=0),
            np.concatenate([spawn(int(seed), rollouts) for seed in seeds[chunk]]),
        )
        states = rollout.states[:, 1:]
        shape = (len(states) // rollouts, rollouts)
        yield (
            states.reshape(*shape, *states.shape[1:]),
            rollout.unobserved.reshape(*shape, *rollout.unobserved.shape[1:]),
        )
        progress(min(1.0, (start + chunk_size) / len(s0)), f"{simulator.name}: repeated rollouts")


@dataclass(frozen=True)
class _Labels:
    """Names the value of a data set that is not finite.

    Attributes:
        simulator: the system.
        name: of the data set.
        row: what the first axis of the arrays is.
        first: number of the first row.
    """

    simulator: Simulator
    name: str
    row: str
    first: int

    def check_scenarios(self, scenarios: Scenarios, actions: Floats) -> None:
        """Check the initial states, goals and planned actions of scenarios."""
        self.check(self.simulator.state, scenarios.s0)
        self.check(self.simulator.goal, scenarios.goal)
        self.check(self.simulator.action, actions, "step")

    def check(
        self, variables: tuple[Variable, ...], values: Floats, *axes: str, first_step: int = 0
    ) -> None:
        """Check that all values are finite.

        Args:
            variables: what the last axis is.
            values: the array.
            axes: what the axes between the first and the last are.
            first_step: number of the first step, if the last of the axes has steps.

        Raises:
            StudyError: a value is not finite.
        """
        finite = np.isfinite(values)
        if finite.all():
            return
        row, *middle, column = np.argwhere(~finite)[0]
        value = values[row, *middle, column]
        numbers = [self.first + row, *middle]
        if axes and axes[-1] == "step":
            numbers[-1] += first_step
        places = zip((self.row, *axes), numbers, strict=True)
        where = ", ".join(f"{axis} {number}" for axis, number in places)
        rows = int((~finite).reshape(len(finite), -1).any(axis=1).sum())
        raise StudyError(
            f"{self.simulator.name}, {self.name} set: {where}: {variables[column].name} is {value} "
            f"({rows} of {len(values)} here are not finite); numbers of a system must be finite"
        )


def _facts(simulator: Simulator, seed: int) -> dict[str, Any]:
    """The facts that a data set's file holds; see `Trajectories.facts`."""
    return {
        "environment": simulator.name,
        "environment_version": simulator.version,
        "control_step": simulator.control_step,
        "state": to_json(simulator.state),
        "action": to_json(simulator.action),
        "unobserved": to_json(simulator.unobserved),
        "goal": to_json(simulator.goal),
        "rotating_pairs": [list(names) for names in simulator.rotating_pairs],
        "symmetries": simulator.symmetries.to_json(),
        "seed": seed,
        "versions": {"study": __version__} | {name: version(name) for name in ("mujoco", "numpy")},
    }
