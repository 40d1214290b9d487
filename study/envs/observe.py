"""How a simulator is observed: training trajectories, and scenarios with repeated rollouts.

Every trajectory has a seed of its own, so the first n of them do not depend on their number.
"""

import math
from collections.abc import Iterator
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

import numpy as np

from study import __version__
from study.common.progress import Progress
from study.common.seeds import Seeds, derive, spawn
from study.data.trajectories import ScenarioSet, Trajectories
from study.envs.simulator import Scenarios, Simulator, Variable, simulators

CHUNK = 1000
"""Trajectories that are planned and rolled out at once: bounds the memory, gives progress."""


def real_system(settings: dict[str, Any]) -> tuple[Simulator, int]:
    """The system that is observed, and the seed that all its data sets come from."""
    environment, collect = settings["environment"], settings["collect"]
    simulator = simulators[environment](horizon=collect["horizon"])
    return simulator, derive(environment, collect["seed"])


def observe_training(settings: dict[str, Any], progress: Progress) -> Iterator[Trajectories]:
    """The training trajectories, some at a time."""
    simulator, seed = real_system(settings)
    count = settings["collect"]["trajectories"]
    return observe_trajectories(simulator, count, derive(seed, "train"), progress)


def observe_trajectories(
    simulator: Simulator, count: int, seed: int, progress: Progress
) -> Iterator[Trajectories]:
    """`count` trajectories, each of its own scenario, some at a time.

    The first n do not depend on `count`.
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
    """Of each trajectory, or scenario, the seed of how it begins [count] and of its noise [count].

    The first n do not depend on `count`.
    """
    return spawn(derive(seed, "scenario"), count), spawn(seed, count)


def sample_planned(simulator: Simulator, seeds: Seeds) -> tuple[Scenarios, np.ndarray]:
    """A scenario for each seed [N], and what is planned for it, [N, T, A]."""
    scenarios = simulator.sample_scenarios(seeds)
    return scenarios, simulator.plan(scenarios, seeds)


def observe_scenarios(
    simulator: Simulator, count: int, rollouts: int, seed: int, progress: Progress
) -> Iterator[ScenarioSet]:
    """`count` scenarios, each rolled out `rollouts` times with noise of its own; some at a time."""
    scenario_seeds, noise_seeds = trajectory_seeds(seed, count)
    scenarios, actions = sample_planned(simulator, scenario_seeds)
    facts, done = _facts(simulator, seed), 0
    for observed, unobserved in repeat_rollouts(
        simulator, scenarios.s0, actions, rollouts, noise_seeds, progress
    ):
        part = slice(done, done + len(observed))
        s0, goal = scenarios.s0[part], scenarios.goal[part]
        yield ScenarioSet(s0, actions[part], goal, observed, unobserved, facts)
        done += len(observed)


def repeat_rollouts(
    simulator: Simulator,
    s0: np.ndarray,
    actions: np.ndarray,
    rollouts: int,
    seeds: np.ndarray,
    progress: Progress,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """States s_1 … s_T [S, K, T, D] and unobserved variables [S, K, H] of K rollouts a scenario.

    They come some scenarios at a time.

    The noise of rollout k of a scenario depends on that scenario's seed and on k alone.
    """
    at_once = max(1, CHUNK // rollouts)
    for start in range(0, len(s0), at_once):
        chunk = slice(start, start + at_once)
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
        progress(min(1.0, (start + at_once) / len(s0)), f"{simulator.name}: repeated rollouts")


def _facts(simulator: Simulator, seed: int) -> dict[str, Any]:
    def finite(bound: float) -> float | None:
        return bound if math.isfinite(bound) else None  # JSON has no infinity

    def table(variables: tuple[Variable, ...]) -> list[dict[str, Any]]:
        return [asdict(v) | {"low": finite(v.low), "high": finite(v.high)} for v in variables]

    return {
        "environment": simulator.name,
        "environment_version": simulator.version,
        "control_step": simulator.control_step,
        "state": table(simulator.state),
        "action": table(simulator.action),
        "unobserved": table(simulator.unobserved),
        "goal": table(simulator.goal),
        "rotating_pairs": [list(names) for names in simulator.rotating_pairs],
        "seed": seed,
        "versions": {"study": __version__} | {name: version(name) for name in ("mujoco", "numpy")},
    }
