"""The data sets of a simulator: training trajectories, and scenarios with repeated rollouts.

Every trajectory has its own seed, so the first n trajectories do not depend on their number.
"""

from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

import numpy as np

from study import __version__
from study.common.arrays import Floats
from study.common.progress import Progress
from study.common.seeds import Seeds, derive, spawn
from study.config.settings import Collect
from study.data.trajectories import ScenarioSet, Trajectories
from study.data.variables import to_json
from study.envs.simulator import Scenarios, Simulator, simulators

CHUNK = 1000
"""Trajectories that are in memory together; progress is reported after each chunk."""


def real_system(environment: str, collect: Collect) -> tuple[Simulator, int]:
    """The simulator that the study observes, and the seed of all its data sets.

    Raises:
        BadInput: the environment is unknown.
    """
    simulator = simulators[environment](horizon=collect.horizon)
    return simulator, derive(environment, collect.seed)


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
    """
    scenario_seeds, noise_seeds = trajectory_seeds(seed, count)
    facts = _facts(simulator, seed)
    for start in range(0, count, CHUNK):
        chunk = slice(start, start + CHUNK)
        scenarios, actions = sample_planned(simulator, scenario_seeds[chunk])
        rollout = simulator.rollout(scenarios.s0, actions, noise_seeds[chunk])
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
    simulator: Simulator, count: int, rollouts: int, seed: int, progress: Progress
) -> Iterator[ScenarioSet]:
    """`count` scenarios with `rollouts` noisy rollouts each, chunk by chunk."""
    scenario_seeds, noise_seeds = trajectory_seeds(seed, count)
    scenarios, actions = sample_planned(simulator, scenario_seeds)
    facts, start = _facts(simulator, seed), 0
    for observed, unobserved in repeat_rollouts(
        simulator, scenarios.s0, actions, rollouts, noise_seeds, progress
    ):
        chunk = slice(start, start + len(observed))
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
        "seed": seed,
        "versions": {"study": __version__} | {name: version(name) for name in ("mujoco", "numpy")},
    }
