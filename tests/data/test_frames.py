"""Rotating pairs in a fixed frame: no information is lost, and north is the same direction."""

from typing import Any

import numpy as np
import torch

from study.data.frames import rotating_pairs_of, to_fixed_frame, to_rotating_frame
from study.data.normalization import Normalization
from study.data.trajectories import Trajectories
from study.envs import simulators
from study.models.rnn_ensemble import RnnEnsemble
from tests.helpers.models import settings

NAMES = ("east", "north", "forward", "left", "heading")
FACTS: dict[str, Any] = {
    "state": [{"name": name} for name in NAMES],
    "rotating_pairs": [["forward", "left", "heading"]],
}


def flights() -> Trajectories:
    """In the fixed frame every pair points north, whatever the heading: a' = 0, b' = 2."""
    generator = np.random.default_rng(0)
    states = generator.normal(size=(8, 5, len(NAMES))).astype(np.float32)
    heading = states[..., 4] = generator.uniform(-9, 9, size=(8, 5))
    states[..., 2], states[..., 3] = 2 * np.sin(heading), 2 * np.cos(heading)
    nothing = np.zeros((8, 0), np.float32)
    return Trajectories(states, np.zeros((8, 4, 1), np.float32), nothing, nothing, FACTS)


def test_the_facts_name_the_columns() -> None:
    np.testing.assert_array_equal(rotating_pairs_of(FACTS), [[2, 3, 4]])
    assert rotating_pairs_of({}).shape == (0, 3)


def test_pairs_in_the_fixed_frame() -> None:
    fixed = to_fixed_frame(
        torch.from_numpy(flights().states.copy()), torch.tensor([[2, 3, 4]])
    ).numpy()
    np.testing.assert_allclose(fixed[..., 2], 0.0, atol=1e-5)
    np.testing.assert_allclose(fixed[..., 3], 2.0, atol=1e-5)
    np.testing.assert_array_equal(fixed[..., [0, 1, 4]], flights().states[..., [0, 1, 4]])


def test_the_rotating_frame_is_the_inverse() -> None:
    pairs, states = torch.tensor([[2, 3, 4]]), torch.from_numpy(flights().states)
    restored = to_rotating_frame(to_fixed_frame(states.clone(), pairs), pairs)
    torch.testing.assert_close(restored, states)


def test_models_work_in_the_fixed_frame() -> None:
    data = flights()
    normalization = Normalization.from_trajectories(data)
    model = RnnEnsemble(normalization, settings("ensemble"))
    np.testing.assert_allclose(normalization.state_mean[2:4], [0.0, 2.0], atol=1e-5)
    normalized = normalization.normalize_states(data.states)
    torch.testing.assert_close(model.normalize_states(torch.from_numpy(data.states)), normalized)
    np.testing.assert_allclose(normalized[..., 2:4], 0.0, atol=1e-4)
    back = model.denormalize(normalized).numpy()
    np.testing.assert_allclose(back, data.states, atol=1e-4)
    assert not np.shares_memory(data.states, normalized.numpy())


def test_environments_name_existing_variables() -> None:
    for name in ("pusher", "uav"):
        variables = {variable.name: variable.unit for variable in simulators[name].state}
        for pair in simulators[name].rotating_pairs:
            assert [variables[component] for component in pair][2] == "rad"


def test_the_uav_accelerates_along_its_tilt_in_the_fixed_frame() -> None:
    """Acceleration is linear in the tilt in the fixed frame, but not in roll and pitch."""
    simulator = simulators["uav"](horizon=20)
    seeds = np.arange(64, dtype=np.uint64)
    scenarios = simulator.sample_scenarios(seeds)
    states = simulator.rollout(scenarios.s0, simulator.plan(scenarios, seeds)).states
    names = [variable.name for variable in simulator.state]
    facts = {
        "state": [{"name": name} for name in names],
        "rotating_pairs": simulator.rotating_pairs,
    }
    fixed = to_fixed_frame(
        torch.from_numpy(states.copy()), torch.from_numpy(rotating_pairs_of(facts))
    ).numpy()
    tilt = [names.index("roll"), names.index("pitch")]
    change = np.diff(states[..., names.index("vx")], axis=1).ravel()

    def explained(states: np.ndarray) -> float:
        inputs = states[:, 1:, tilt].reshape(-1, 2)
        residual = change - inputs @ np.linalg.lstsq(inputs, change, rcond=None)[0]
        return float(1 - residual.var() / change.var())

    assert explained(fixed) > 2 * explained(states)
    assert explained(fixed) > 0.4
