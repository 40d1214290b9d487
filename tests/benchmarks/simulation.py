"""How fast the environments are: ``python -m tests.benchmarks.simulation``.

Control steps per second on all cores, each contender in turn:

- *batch*: `Simulator.rollout`, as stage collect calls it, with all noise;
- *mujoco.rollout*: MuJoCo from C threads on the environment's model, one system a world, with
  constant control, no noise, and nothing read or written in between;
- *Gymnasium*: the same environment, open loop, through `gymnasium.vector.SyncVectorEnv`;
- *swarm by mujoco.rollout*, for the Pusher: `mujoco.rollout` on worlds of several systems, as the
  batch has them.

The fastest of several repeats counts: other work on the machine only slows.
"""

import argparse
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
from tests.benchmarks.report import save
from tests.benchmarks.timing import cores

ENVIRONMENTS = ("pusher", "uav")
VECTOR = 8
"""Environments of `SyncVectorEnv`."""
WORLDS = 64
"""Worlds that `mujoco.rollout` gets at once."""


def contenders(name: str, trajectories: int) -> dict[str, tuple[Callable[[], object], int]]:
    """What is timed, and how many control steps it simulates."""
    simulator = simulators[name](threads=cores())
    seeds = spawn(0, trajectories)
    scenarios = simulator.sample_scenarios(seeds)
    actions = simulator.plan(scenarios, seeds)
    steps = trajectories * simulator.horizon
    vector = gymnasium.vector.SyncVectorEnv([lambda: _environment(name)] * VECTOR)
    environment = vector.envs[0].unwrapped
    assert isinstance(environment, SimulatorEnv)
    scaled = [environment.scaled(actions[:VECTOR, t]) for t in range(simulator.horizon)]

    def through_gymnasium() -> None:
        vector.reset(seed=0)
        for action in scaled:
            vector.step(action)

    found: dict[str, tuple[Callable[[], object], int]] = {
        "batch": (lambda: simulator.rollout(scenarios.s0, actions, seeds), steps),
        "mujoco.rollout": (_rollout(simulator.scene(), simulator, trajectories), steps),
        "Gymnasium": (through_gymnasium, VECTOR * simulator.horizon),
    }
    if isinstance(simulator, Pusher):
        swarm = _rollout(simulator.swarm, simulator, trajectories // SWARM)
        found["swarm by mujoco.rollout"] = swarm, steps
    return found


def _environment(name: str) -> gymnasium.Env[np.ndarray, np.ndarray]:
    return gymnasium.make(gymnasium_id(simulators[name]))


def _rollout(model: mujoco.MjModel, simulator: Simulator, worlds: int) -> Callable[[], object]:
    """`worlds` copies of a model under constant control, for the horizon, on all threads."""
    data = [mujoco.MjData(model) for _ in range(simulator.threads)]
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    initial = np.empty(size)
    mujoco.mj_getState(model, data[0], initial, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    steps = simulator.horizon * round(simulator.control_step / model.opt.timestep)

    def run() -> None:
        with Physics(nthread=simulator.threads if simulator.threads > 1 else 0) as physics:
            for start in range(0, worlds, WORLDS):
                count = min(WORLDS, worlds - start)
                control = np.full((count, steps, model.nu), 0.01)
                states = np.tile(initial, (count, 1))
                physics.rollout(model, data, states, control, nstep=steps)

    return run


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trajectories", type=int, default=2048)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    rows = []
    for name in ENVIRONMENTS:
        timed = contenders(name, arguments.trajectories)
        seconds = dict.fromkeys(timed, np.inf)
        for _ in range(arguments.repeats):
            for label, (run, _) in timed.items():
                start = time.perf_counter()
                run()
                seconds[label] = min(seconds[label], time.perf_counter() - start)
        for label, (_, steps) in timed.items():
            rate = steps / seconds[label]
            rows.append({"environment": name, "contender": label, "rate": rate})
            print(f"{name:8} {label:26} {rate:12,.0f} control steps/s", flush=True)
    save("simulation", rows)


if __name__ == "__main__":
    main()
