"""UAVs at rest, in hover, and on planned flights."""

import numpy as np

from study.common.arrays import Floats
from study.common.seeds import Seeds, spawn
from study.envs import Simulator, uav
from study.envs.uav_flight import Flight


def still(count: int, height: float = 30.0, **columns: float) -> Floats:
    """Vehicles [N, 17] at rest in still air of standard temperature, fully charged."""
    names = [variable.name for variable in uav.Uav.state]
    s0 = np.zeros((count, len(names)), np.float32)
    for name, value in ({"z": height, "temperature": 15.0, "battery": 100.0} | columns).items():
        s0[:, names.index(name)] = value
    return s0


def hover(flight: Flight, seconds: float, command: tuple[float, ...] = (0, 0, 0, 0)) -> Floats:
    """The states [N, 17] after a constant command, which is renewed every two seconds."""
    actions = np.tile(np.array(command, np.float32), (flight.count, 1))
    for _ in range(round(seconds / 2)):
        state = flight.advance(actions, round(2.0 / flight.timestep))
    return state


def fly(simulator: Simulator, count: int, seed: int = 0) -> tuple[Floats, Floats, Seeds]:
    """Initial states, plans and seeds of `count` scenarios."""
    seeds = spawn(seed, count)
    scenarios = simulator.sample_scenarios(seeds)
    return scenarios.s0, simulator.plan(scenarios, seeds), seeds
