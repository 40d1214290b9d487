"""Stage collect: observe one real system.

Writes ``train.safetensors`` (Trajectories), ``validation.safetensors`` and ``test.safetensors``
(ScenarioSets) and ``kernel.json``: the units and bandwidths in which every forecast is scored.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from study.data.trajectories import ScenarioSet, Trajectories
from study.envs import Simulator, simulators
from study.files import write_json
from study.metrics.mmd import bandwidths
from study.progress import Progress
from study.seeds import derive, spawn

# Trajectories that are planned and rolled out at once: bounds the memory, gives progress.
CHUNK = 1000
# Rollouts of each validation scenario: with more than one, forecasts can be scored by MMD².
VALIDATION_ROLLOUTS = 4


def run(settings: dict[str, Any], inputs: dict[str, Path], out: Path, progress: Progress) -> None:
    """See the module. Training, validation and test scenarios have seeds of their own."""
    collect, environment = settings["collect"], settings["environment"]
    simulator = simulators[environment](horizon=collect["horizon"])
    seed = derive(environment, collect["seed"])
    train = observe_trajectories(
        simulator, collect["trajectories"], derive(seed, "train"), progress.part(0.0, 0.5)
    )
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


def observe_trajectories(
    simulator: Simulator, count: int, seed: int, progress: Progress
) -> Trajectories:
    """`count` trajectories, each of its own scenario. The first n do not depend on `count`."""
    scenario_seeds, noise_seeds = spawn(derive(seed, "scenario"), count), spawn(seed, count)
    parts = []
    for start in range(0, count, CHUNK):
        chunk = slice(start, start + CHUNK)
        scenarios = simulator.draw(scenario_seeds[chunk])
        actions = simulator.plan(scenarios, scenario_seeds[chunk])
        rollout = simulator.rollout(scenarios.s0, actions, noise_seeds[chunk])
        parts.append((rollout.states, actions, rollout.hidden))
        progress(min(1.0, (start + CHUNK) / count), f"{simulator.name}: training trajectories")
    states, actions, hidden = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return Trajectories(states, actions, hidden, _facts(simulator, seed))


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
    def table(variables: tuple[Any, ...]) -> list[list[str]]:
        return [[v.name, v.unit] for v in variables]

    return {
        "environment": simulator.name,
        "environment_version": simulator.version,
        "control_step": simulator.control_step,
        "state": table(simulator.state),
        "action": table(simulator.action),
        "hidden": table(simulator.hidden),
        "task": table(simulator.task),
        "seed": seed,
    }
