"""How fast the environments are: ``python -m tests.benchmarks.simulation``.

Side by side in one run, on all cores, in control steps per second:

- *batch*: `Simulator.rollout`, as stage collect calls it, with all its noise;
- *one model a world*: MuJoCo's own limit: `mujoco.rollout` from C threads on the environment's
  model, with constant control, no noise, and nothing read or written in between;
- *Gymnasium*: the same task, open loop, through `gymnasium.vector.SyncVectorEnv`;
- for the Pusher, *swarm by mujoco.rollout*: what the batch could have, if its physics was run by
  `mujoco.rollout`, open loop, instead of `mujoco.batch`.

Each is timed several times in turn, and the fastest counts: other work on the machine only slows.
"""

import argparse
import os
import time
from collections.abc import Callable

import gymnasium
import mujoco
import numpy as np
from mujoco.rollout import Rollout as Physics

from study.common.seeds import spawn
from study.envs import Simulator, gymnasium_id, simulators
from study.envs.gymnasium_env import SimulatorEnv
from study.envs.pusher import SWARM, Pusher

TARGETS = {"pusher": 0.8, "uav": 0.5}
"""Least share of the limit that the batch should reach."""
GYMNASIUM_TARGET = 15


def contenders(name: str, trajectories: int) -> dict[str, tuple[Callable[[], object], int]]:
    """What is timed, and how many control steps it simulates."""
    threads = len(os.sched_getaffinity(0))
    simulator = simulators[name](threads=threads)
    seeds = spawn(0, trajectories)
    scenarios = simulator.sample_scenarios(seeds)
    actions = simulator.plan(scenarios, seeds)
    steps = trajectories * simulator.horizon
    few = 8
    vector = gymnasium.vector.SyncVectorEnv([lambda: _make(name)] * few)
    scaled = [vector.envs[0].unwrapped.scaled(actions[:few, t]) for t in range(simulator.horizon)]  # type: ignore[attr-defined]

    def through_gymnasium() -> None:
        vector.reset(seed=0)
        for action in scaled:
            vector.step(action)

    found: dict[str, tuple[Callable[[], object], int]] = {
        "batch": (lambda: simulator.rollout(scenarios.s0, actions, seeds), steps),
        "one model a world": (_limit(simulator, trajectories), steps),
        "Gymnasium": (through_gymnasium, few * simulator.horizon),
    }
    if isinstance(simulator, Pusher):
        found["swarm by mujoco.rollout"] = (_swarm(simulator, trajectories), steps)
    return found


def _make(name: str) -> gymnasium.Env[np.ndarray, np.ndarray]:
    environment = gymnasium.make(gymnasium_id(simulators[name]))
    assert isinstance(environment.unwrapped, SimulatorEnv)
    return environment


def _limit(simulator: Simulator, trajectories: int) -> Callable[[], object]:
    return _rollout(simulator.scene(), simulator, trajectories)


def _swarm(simulator: Pusher, trajectories: int) -> Callable[[], object]:
    return _rollout(simulator.swarm, simulator, trajectories // SWARM)


def _rollout(model: mujoco.MjModel, simulator: Simulator, worlds: int) -> Callable[[], object]:
    """`worlds` copies of a model under constant control, for the horizon, on all threads."""
    data = [mujoco.MjData(model) for _ in range(simulator.threads)]
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    initial = np.empty(size)
    mujoco.mj_getState(model, data[0], initial, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    steps = simulator.horizon * round(simulator.control_step / model.opt.timestep)
    at_once = 64

    def run() -> None:
        with Physics(nthread=simulator.threads if simulator.threads > 1 else 0) as physics:
            for start in range(0, worlds, at_once):
                count = min(at_once, worlds - start)
                control = np.full((count, steps, model.nu), 0.01)
                states = np.tile(initial, (count, 1))
                physics.rollout(model, data, states, control, nstep=steps)

    return run


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trajectories", type=int, default=2048)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    for name, target in TARGETS.items():
        timed = contenders(name, arguments.trajectories)
        seconds = dict.fromkeys(timed, np.inf)
        for _ in range(arguments.repeats):
            for label, (run, _) in timed.items():
                start = time.perf_counter()
                run()
                seconds[label] = min(seconds[label], time.perf_counter() - start)
        rates = {label: steps / seconds[label] for label, (_, steps) in timed.items()}
        print(f"\n{simulators[name].title}, {os.cpu_count()} cores")
        for label, rate in rates.items():
            ratio = rates["batch"] / rate
            print(f"  {label:26} {rate:12,.0f} control steps/s   batch is {ratio:6.2f} ×")
        share = rates["batch"] / rates["one model a world"]
        times = rates["batch"] / rates["Gymnasium"]
        print(f"  at least {target} of the limit: {'yes' if share >= target else 'no'}")
        print(f"  at least {GYMNASIUM_TARGET} × Gymnasium: {'yes' if times >= 15 else 'no'}")


if __name__ == "__main__":
    main()
