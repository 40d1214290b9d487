"""The recording of training data: the same numbers as the data, small, and explained."""

from pathlib import Path

import numpy as np

from study.data.trajectories import Trajectories
from study.recording.data import record_data
from study.recording.files import check
from study.recording.reading import entities, properties, scalars
from study.seeds import spawn
from tests.recording import toy


def trajectories(count: int = 5) -> Trajectories:
    simulator, seeds = toy.Puck(), spawn(0, count)
    scenarios = simulator.draw(seeds)
    actions = simulator.plan(scenarios, seeds)
    rollout = simulator.rollout(scenarios.s0, actions, seeds)
    return Trajectories(rollout.states, actions, scenarios.task, rollout.hidden, {})


def test_signals_are_those_of_the_trajectories(tmp_path: Path) -> None:
    data, path = trajectories(), tmp_path / "data.rrd"
    record_data(path, toy.Puck(), data, toy.PROPERTIES)
    check(path)
    assert properties(path)["cell"] == toy.PROPERTIES["cell"]
    assert {"/state/x", "/state/y", "/action/f_x", "/action/f_y"} <= set(entities(path))
    for column, name in ((0, "x"), (1, "y")):
        read = scalars(path, f"/state/{name}").to_numpy(np.float64)
        np.testing.assert_allclose(read[:, -5:], data.states[..., column].T, rtol=1e-6)
    assert path.stat().st_size < 1_000_000
