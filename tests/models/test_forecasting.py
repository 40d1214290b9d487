"""Ensembles behind a forecaster: their members' forecasts, and the member of each sample."""

from typing import Any

import numpy as np
import pytest
import torch

from study.common.progress import Progress
from study.common.seeds import spawn
from study.data.trajectories import ScenarioSet
from study.models.forecasting import (
    ensemble_of,
    example_arrays,
    forecast_in_parts,
    forecast_members,
    members_of_samples,
)
from tests.helpers.models import HORIZON, MEMBERS, STATE, ensemble, model, trajectories

ENSEMBLES = ["full_vae_ensemble", "residual_vae_ensemble", "probabilistic_ensemble"]


def scenario_set(count: int) -> ScenarioSet:
    data = trajectories(count, seed=1)
    goal, observed = np.zeros((count, 1), np.float32), data.states[:, None, 1:]
    unobserved = np.zeros((count, 1, 0), np.float32)
    return ScenarioSet(data.states[:, 0], data.actions, goal, observed, unobserved, {})


@pytest.mark.parametrize("name", ENSEMBLES)
def test_the_members_forecasts_are_those_without_noise(name: str) -> None:
    network: Any = model(name)
    data = trajectories(4, seed=1)
    found = forecast_members(network, data.states[:, 0], data.actions)
    assert found.shape == (4, MEMBERS, HORIZON, STATE)
    inputs = network.normalize(torch.from_numpy(data.states[:, 0]), torch.from_numpy(data.actions))
    if name == "residual_vae_ensemble":
        expected = network.ensemble(*inputs)
    else:
        members = network.member_models()
        noise = torch.zeros(4, 1, HORIZON, members[0].noise_size)
        zero = torch.zeros(4, 1, dtype=torch.int64)
        expected = torch.cat([member.sample(*inputs, noise, zero) for member in members], dim=1)
    normalized = network.normalize_states(torch.from_numpy(found))
    torch.testing.assert_close(normalized, expected.detach(), rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("name", "changes", "count"),
    [
        ("full_vae", {}, 1),
        ("residual_vae", {}, MEMBERS),
        ("full_vae_ensemble", {}, MEMBERS),
        ("residual_vae_ensemble", {}, MEMBERS * MEMBERS),
        ("probabilistic_ensemble", {}, MEMBERS),
        ("probabilistic_ensemble", {"probabilistic_ensemble": {"propagation": "step"}}, 1),
    ],
)
def test_the_members_of_samples(name: str, changes: Any, count: int) -> None:
    network = model(name, **changes)
    assert network.members_count() == count
    member = members_of_samples(network, spawn(0, 20), 10)
    if count == 1:
        assert member is None
    else:
        assert member is not None
        assert member.shape == (20, 10)
        assert set(member.ravel()) == set(range(count))


def test_the_ensemble_of_a_forecaster() -> None:
    alone, residual, whole = ensemble(), model("residual_vae"), model("full_vae_ensemble")
    assert ensemble_of(alone) is alone
    assert ensemble_of(residual) is residual.ensemble
    assert ensemble_of(whole) is whole
    assert ensemble_of(model("full_vae")) is None


def test_parts_are_forecast_like_the_whole() -> None:
    network, test, seeds = model("residual_vae"), scenario_set(25), spawn(3, 25)
    found = forecast_in_parts(network, test, 4, seeds, Progress())
    expected = network.forecast(test.s0, test.actions, 4, seeds)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", ["residual_vae", "full_vae"])
def test_the_arrays_of_examples(name: str) -> None:
    network, test, seeds, index = model(name), scenario_set(6), spawn(3, 6), np.array([4, 1])
    forecasts = network.forecast(test.s0, test.actions, 5, seeds)
    arrays = example_arrays(network, test, forecasts, seeds, index)
    np.testing.assert_array_equal(arrays["forecast"], forecasts[index])
    np.testing.assert_array_equal(arrays["s0"], test.s0[index])
    assert ("member" in arrays) == ("members" in arrays) == (name == "residual_vae")
    if name == "residual_vae":
        assert arrays["member"].shape == (2, 5)
        assert arrays["members"].shape == (2, MEMBERS, HORIZON, STATE)
