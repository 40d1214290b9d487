"""Pairs in axes that stand still: nothing is lost, and what pushes north is called north."""

from typing import Any

import numpy as np
import torch

from study.data.frames import rotating_pairs_of, turn
from study.data.normalization import Normalization
from study.data.trajectories import Trajectories
from study.envs import simulators
from study.models.rnn_ensemble import Ensemble
from tests.helpers.models import settings

NAMES = ("east", "north", "forward", "left", "heading")
FACTS: dict[str, Any] = {
    "state": [{"name": name} for name in NAMES],
    "rotating_pairs": [["forward", "left", "heading"]],
}


def flights() -> Trajectories:
    """Of each the pair points north, whichever way the vehicle faces: b' = 2, a' = 0."""
    generator = np.random.default_rng(0)
    states = generator.normal(size=(8, 5, len(NAMES))).astype(np.float32)
    heading = states[..., 4] = generator.uniform(-9, 9, size=(8, 5))
    states[..., 2], states[..., 3] = 2 * np.sin(heading), 2 * np.cos(heading)
    nothing = np.zeros((8, 0), np.float32)
    return Trajectories(states, np.zeros((8, 4, 1), np.float32), nothing, nothing, FACTS)


def test_the_facts_name_the_columns() -> None:
    np.testing.assert_array_equal(rotating_pairs_of(FACTS), [[2, 3, 4]])
    assert rotating_pairs_of({}).shape == (0, 3)


def test_turned_pairs_stand_still() -> None:
    level = turn(torch.from_numpy(flights().states.copy()), torch.tensor([[2, 3, 4]])).numpy()
    np.testing.assert_allclose(level[..., 2], 0.0, atol=1e-5)
    np.testing.assert_allclose(level[..., 3], 2.0, atol=1e-5)
    np.testing.assert_array_equal(level[..., [0, 1, 4]], flights().states[..., [0, 1, 4]])


def test_models_see_them_turned_and_forecasts_are_turned_back() -> None:
    data = flights()
    normalization = Normalization.of(data)
    model = Ensemble(normalization, settings())
    np.testing.assert_allclose(normalization.state_mean[2:4], [0.0, 2.0], atol=1e-5)
    standard = normalization.normalize_states(data.states)
    torch.testing.assert_close(model.normalize_states(torch.from_numpy(data.states)), standard)
    np.testing.assert_allclose(standard[..., 2:4], 0.0, atol=1e-4)
    back = model.denormalize(standard).numpy()
    np.testing.assert_allclose(back, data.states, atol=1e-4)
    assert not np.shares_memory(data.states, standard.numpy())


def test_every_environment_names_variables_that_it_has() -> None:
    for name in simulators:
        variables = {variable.name: variable.unit for variable in simulators[name].state}
        for pair in simulators[name].rotating_pairs:
            assert [variables[each] for each in pair][2] == "rad"


def test_the_uav_accelerates_along_its_turned_tilt() -> None:
    """Of roll and pitch alone, acceleration is no linear function; of the turned pair it is."""
    simulator = simulators["uav"](horizon=20)
    seeds = np.arange(64, dtype=np.uint64)
    scenarios = simulator.sample_scenarios(seeds)
    states = simulator.rollout(scenarios.s0, simulator.plan(scenarios, seeds)).states
    names = [variable.name for variable in simulator.state]
    facts = {
        "state": [{"name": name} for name in names],
        "rotating_pairs": simulator.rotating_pairs,
    }
    level = turn(
        torch.from_numpy(states.copy()), torch.from_numpy(rotating_pairs_of(facts))
    ).numpy()
    tilt = [names.index("roll"), names.index("pitch")]
    change = np.diff(states[..., names.index("vx")], axis=1).ravel()

    def explained(seen: np.ndarray) -> float:
        inputs = seen[:, 1:, tilt].reshape(-1, 2)
        left = change - inputs @ np.linalg.lstsq(inputs, change, rcond=None)[0]
        return float(1 - left.var() / change.var())

    assert explained(level) > 2 * explained(states)
    assert explained(level) > 0.4
