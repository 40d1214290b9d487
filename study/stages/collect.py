"""Stage collect: observe one real system.

Writes ``train.safetensors`` (Trajectories), ``validation.safetensors`` and ``test.safetensors``
(ScenarioSets) and ``kernel.json``: the units and bandwidths in which every forecast is scored.
"""

import json
import math
from collections.abc import Iterator
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from study import __version__
from study.common.files import write_json
from study.common.progress import Progress
from study.common.seeds import Seeds, derive, spawn
from study.data.moments import moments
from study.data.storage import load_parts
from study.data.trajectories import ScenarioSet, Trajectories, save_all
from study.envs import Scenarios, Simulator, Variable, simulators
from study.metrics.mmd import bandwidths

# Trajectories that are planned and rolled out at once: bounds the memory, gives progress.
CHUNK = 1000
# Rollouts of each validation scenario: with more than one, forecasts can be scored by MMD².
VALIDATION_ROLLOUTS = 4


def run(settings: dict[str, Any], inputs: dict[str, Path], out: Path, progress: Progress) -> None:
    """See the module. Training, validation and test scenarios have seeds of their own."""
    collect, (simulator, seed) = settings["collect"], real_system(settings)
    train = observe_training(settings, progress.part(0.0, 0.5))
    save_all(out / "train.safetensors", train, collect["trajectories"])
    for name, count, rollouts, part in (
        ("validation", collect["validation"], VALIDATION_ROLLOUTS, progress.part(0.5, 0.6)),
        ("test", collect["scenarios"], collect["rollouts"], progress.part(0.6, 1.0)),
    ):
        scenarios = observe_scenarios(simulator, count, rollouts, derive(seed, name), part)
        save_all(out / f"{name}.safetensors", scenarios, count)
    # The kernel is measured on validation rollouts: the test set serves for nothing but scores.
    validation = ScenarioSet.load(out / "validation.safetensors")
    _, scale = moments(lambda: load_parts(out / "train.safetensors", "states", CHUNK))
    bandwidth = bandwidths(validation.observed, scale)
    write_json(
        out / "kernel.json",
        {
            "names": [variable.name for variable in simulator.state],
            "scale": scale.tolist(),
            "bandwidth": bandwidth.tolist(),
        },
    )


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
        scenarios, actions = draw_planned(simulator, scenario_seeds[chunk])
        rollout = simulator.rollout(scenarios.s0, actions, noise_seeds[chunk])
        yield Trajectories(rollout.states, actions, scenarios.task, rollout.hidden, facts)
        progress(min(1.0, (start + CHUNK) / count), f"{simulator.name}: training trajectories")


def trajectory_seeds(seed: int, count: int) -> tuple[Seeds, Seeds]:
    """Of each trajectory, or scenario, the seed of how it begins [count] and of its noise [count].

    The first n do not depend on `count`.
    """
    return spawn(derive(seed, "scenario"), count), spawn(seed, count)


def draw_planned(simulator: Simulator, seeds: Seeds) -> tuple[Scenarios, np.ndarray]:
    """A scenario for each seed [N], and what is planned for it, [N, T, A]."""
    scenarios = simulator.draw(seeds)
    return scenarios, simulator.plan(scenarios, seeds)


def observe_scenarios(
    simulator: Simulator, count: int, rollouts: int, seed: int, progress: Progress
) -> Iterator[ScenarioSet]:
    """`count` scenarios, each rolled out `rollouts` times with noise of its own; some at a time."""
    scenario_seeds, noise_seeds = trajectory_seeds(seed, count)
    scenarios, actions = draw_planned(simulator, scenario_seeds)
    facts, done = _facts(simulator, seed), 0
    for observed, hidden in repeat_rollouts(
        simulator, scenarios.s0, actions, rollouts, noise_seeds, progress
    ):
        part = slice(done, done + len(observed))
        s0, task = scenarios.s0[part], scenarios.task[part]
        yield ScenarioSet(s0, actions[part], task, observed, hidden, facts)
        done += len(observed)


def repeat_rollouts(
    simulator: Simulator,
    s0: np.ndarray,
    actions: np.ndarray,
    rollouts: int,
    seeds: np.ndarray,
    progress: Progress,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """States s_1 … s_T [S, K, T, D] and hidden variables [S, K, H] of K rollouts a scenario.

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
            rollout.hidden.reshape(*shape, *rollout.hidden.shape[1:]),
        )
        progress(min(1.0, (start + at_once) / len(s0)), f"{simulator.name}: repeated rollouts")


def read_kernel(folder: Path) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names [D], scale [D] and bandwidth [D] that `run` wrote."""
    kernel = json.loads((folder / "kernel.json").read_text())
    return kernel["names"], np.array(kernel["scale"]), np.array(kernel["bandwidth"])


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
        "hidden": table(simulator.hidden),
        "task": table(simulator.task),
        "turned": [list(names) for names in simulator.turned],
        "seed": seed,
        "versions": {"study": __version__} | {name: version(name) for name in ("mujoco", "numpy")},
    }
