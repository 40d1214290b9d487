"""Stage collect: observe one real system.

Writes ``train.safetensors`` (Trajectories), ``validation.safetensors`` and ``test.safetensors``
(ScenarioSets) and ``kernel.json``: the units and bandwidths in which every forecast is scored.
"""

import json
import math
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from study import __version__
from study.data.trajectories import ScenarioSet, Trajectories
from study.envs import Simulator, Variable, simulators
from study.files import write_json
from study.metrics.mmd import bandwidths
from study.progress import Progress
from study.seeds import Seeds, derive, spawn

# Trajectories that are planned and rolled out at once: bounds the memory, gives progress.
CHUNK = 1000
# Rollouts of each validation scenario: with more than one, forecasts can be scored by MMD².
VALIDATION_ROLLOUTS = 4


def run(settings: dict[str, Any], inputs: dict[str, Path], out: Path, progress: Progress) -> None:
    """See the module. Training, validation and test scenarios have seeds of their own."""
    collect, (simulator, seed) = settings["collect"], real_system(settings)
    train = observe_training(settings, progress.part(0.0, 0.5))
    train.save(out / "train.safetensors")
    validation = observe_scenarios(
        simulator,
        collect["validation"],
        VALIDATION_ROLLOUTS,
        derive(seed, "validation"),
        progress.part(0.5, 0.6),
    )
    validation.save(out / "validation.safetensors")
    observe_scenarios(
        simulator,
        collect["scenarios"],
        collect["rollouts"],
        derive(seed, "test"),
        progress.part(0.6, 1.0),
    ).save(out / "test.safetensors")
    # The kernel is measured on validation rollouts: the test set serves for nothing but scores.
    scale = train.states.std(axis=(0, 1), dtype=np.float64)
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


def observe_training(settings: dict[str, Any], progress: Progress) -> Trajectories:
    """The training trajectories."""
    simulator, seed = real_system(settings)
    count = settings["collect"]["trajectories"]
    return observe_trajectories(simulator, count, derive(seed, "train"), progress)


def observe_trajectories(
    simulator: Simulator, count: int, seed: int, progress: Progress
) -> Trajectories:
    """`count` trajectories, each of its own scenario. The first n do not depend on `count`."""
    scenario_seeds, noise_seeds = trajectory_seeds(seed, count)
    parts = []
    for start in range(0, count, CHUNK):
        chunk = slice(start, start + CHUNK)
        scenarios = simulator.draw(scenario_seeds[chunk])
        actions = simulator.plan(scenarios, scenario_seeds[chunk])
        rollout = simulator.rollout(scenarios.s0, actions, noise_seeds[chunk])
        parts.append((rollout.states, actions, scenarios.task, rollout.hidden))
        progress(min(1.0, (start + CHUNK) / count), f"{simulator.name}: training trajectories")
    states, actions, task, hidden = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return Trajectories(states, actions, task, hidden, _facts(simulator, seed))


def trajectory_seeds(seed: int, count: int) -> tuple[Seeds, Seeds]:
    """Of each trajectory, the seed of its scenario [count] and that of its noise [count]."""
    return spawn(derive(seed, "scenario"), count), spawn(seed, count)


def observe_scenarios(
    simulator: Simulator, count: int, rollouts: int, seed: int, progress: Progress
) -> ScenarioSet:
    """`count` scenarios, each rolled out `rollouts` times with noise of its own."""
    scenario_seeds = spawn(derive(seed, "scenario"), count)
    scenarios = simulator.draw(scenario_seeds)
    actions = simulator.plan(scenarios, scenario_seeds)
    observed, hidden = repeat_rollouts(
        simulator, scenarios.s0, actions, rollouts, spawn(seed, count), progress
    )
    return ScenarioSet(
        scenarios.s0, actions, scenarios.task, observed, hidden, _facts(simulator, seed)
    )


def repeat_rollouts(
    simulator: Simulator,
    s0: np.ndarray,
    actions: np.ndarray,
    rollouts: int,
    seeds: np.ndarray,
    progress: Progress,
) -> tuple[np.ndarray, np.ndarray]:
    """States s_1 … s_T [S, K, T, D] and hidden variables [S, K, H] of K rollouts a scenario.

    The noise of rollout k of a scenario depends on that scenario's seed and on k alone.
    """
    at_once = max(1, CHUNK // rollouts)
    states, hidden = [], []
    for start in range(0, len(s0), at_once):
        chunk = slice(start, start + at_once)
        rollout = simulator.rollout(
            np.repeat(s0[chunk], rollouts, axis=0),
            np.repeat(actions[chunk], rollouts, axis=0),
            np.concatenate([spawn(int(seed), rollouts) for seed in seeds[chunk]]),
        )
        states.append(rollout.states[:, 1:])
        hidden.append(rollout.hidden)
        progress(min(1.0, (start + at_once) / len(s0)), f"{simulator.name}: repeated rollouts")
    shape = (len(s0), rollouts)
    return (
        np.concatenate(states).reshape(*shape, *states[0].shape[1:]),
        np.concatenate(hidden).reshape(*shape, *hidden[0].shape[1:]),
    )


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
        "seed": seed,
        "versions": {"study": __version__} | {name: version(name) for name in ("mujoco", "numpy")},
    }
