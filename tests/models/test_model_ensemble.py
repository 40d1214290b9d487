"""Ensembles of whole models: each sample has one member, and members are independent."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from study.config.grid import Cell
from study.config.model_sections import ModelEnsemble, ProbabilisticEnsemble
from study.config.settings import Config
from study.models.full_crps import FullCrps
from study.models.full_crps_ensemble import FullCrpsEnsemble
from study.models.full_vae_ensemble import FullVaeEnsemble
from study.workflow.pipeline import Pipeline
from tests.helpers.models import (
    ACTION,
    HORIZON,
    MEMBERS,
    OURS,
    SMALL,
    STATE,
    model,
    normalization,
    settings,
)

NAMES = [
    "full_vae_ensemble",
    "residual_vae_ensemble",
    "full_crps_ensemble",
    "probabilistic_ensemble",
]


def training_batch(network: Any) -> dict[str, Tensor]:
    torch.manual_seed(1)
    data = {
        "states": torch.randn(MEMBERS, 8, HORIZON + 1, STATE),
        "actions": torch.randn(MEMBERS, 8, HORIZON, ACTION),
    }
    if network.uses_ensemble:
        data["members"] = torch.randn(MEMBERS, 8, 3, HORIZON, STATE)
    return data


def gradients(network: Any, data: dict[str, Tensor]) -> list[list[Tensor]]:
    """Those of each member, with the same random numbers."""
    network.zero_grad()
    torch.manual_seed(2)
    network.losses(data, 0)["loss"].backward()
    return [
        [p.grad.clone() for p in member.parameters() if p.grad is not None]
        for member in network.member_models()
    ]


def forecast_alone(network: Any, number: int, s0: Tensor, actions: Tensor, noise: Tensor) -> Tensor:
    """The forecast [T, D] of one scenario [1, ...] by the member with this number."""
    zero = torch.zeros(1, 1, dtype=torch.int64)
    if network.uses_ensemble:
        index, recurrent = divmod(number, network.ensemble.members_count())
        members = network.ensemble(s0, actions)[:, recurrent, None]
        vae = network.member_models()[index]
        return vae.generate(s0, actions, noise, zero, members)[0, 0]
    return network.member_models()[number].sample(s0, actions, noise, zero)[0, 0]


@pytest.mark.parametrize("name", NAMES)
def test_a_sample_is_the_forecast_of_its_member_alone(name: str) -> None:
    network = model(name)
    count = network.members_count()
    torch.manual_seed(0)
    s0, actions = torch.randn(2, STATE), torch.randn(2, HORIZON, ACTION)
    noise = torch.randn(2, 1, HORIZON, network.noise_size).expand(-1, count, -1, -1)
    member = torch.stack([torch.arange(count), torch.randperm(count)])
    forecasts = network.sample(s0, actions, noise, member)
    for scenario in range(2):
        one = slice(scenario, scenario + 1)
        for k, number in enumerate(member[scenario].tolist()):
            alone = forecast_alone(network, number, s0[one], actions[one], noise[one, :1])
            torch.testing.assert_close(forecasts[scenario, k], alone, rtol=1e-4, atol=1e-5)
    # The noise is the same: only the members differ, and all of them do.
    first = forecasts[0].detach().numpy()
    distance = np.abs(first[:, None] - first).max((2, 3)) + np.eye(count)
    assert distance.min() > 1e-4


@pytest.mark.parametrize("name", NAMES)
def test_a_member_learns_from_its_own_data_alone(name: str) -> None:
    network = model(name)
    data = training_batch(network)
    reference = gradients(network, data)
    assert all(len(of_member) for of_member in reference)
    other = {key: values.clone() for key, values in data.items()}
    other["states"][1] *= 3.0
    changed = gradients(network, other)
    for index in range(MEMBERS):
        pairs = zip(reference[index], changed[index], strict=True)
        assert all(torch.equal(x, y) for x, y in pairs) == (index != 1)


@pytest.mark.parametrize("name", NAMES)
def test_each_members_gradient_is_clipped_alone(name: str) -> None:
    network: Any = model(name)
    gradients(network, training_batch(network))
    norms = []
    for index, member in enumerate(network.member_models()):
        values = [p.grad for p in member.parameters() if p.grad is not None]
        norm = torch.nn.utils.get_total_norm(values)
        for gradient in values:  # half the limit, except for member 1
            gradient *= (1e3 if index == 1 else 0.5) / norm
    network.configure_gradient_clipping(None, 1.0, "norm")
    for member in network.member_models():
        values = [p.grad for p in member.parameters() if p.grad is not None]
        norms.append(float(torch.nn.utils.get_total_norm(values)))
    assert norms == pytest.approx([0.5, 1.0, 0.5], rel=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_training_lowers_every_members_loss(name: str) -> None:
    network = model(name)
    data = training_batch(network)
    optimizer = torch.optim.Adam([p for p in network.parameters() if p.requires_grad], 1e-2)
    initial = {k: v.clone() for k, v in network.state_dict().items() if k.startswith("ensemble")}
    curves = []
    for step in range(30):
        losses = network.losses(data, step)
        optimizer.zero_grad()
        losses["loss"].backward()
        optimizer.step()
        curves.append([float(losses[f"loss/member_{m}"].detach()) for m in range(MEMBERS)])
        assert float(losses["loss"].detach()) == pytest.approx(sum(curves[-1]), rel=1e-5)
    assert (np.mean(curves[-5:], axis=0) < np.mean(curves[:5], axis=0)).all()
    for key, values in initial.items():
        assert torch.equal(network.state_dict()[key], values)


def test_the_recurrent_networks_are_in_the_file_once() -> None:
    network = model("residual_vae_ensemble")
    names = [name for name in network.state_dict() if "ensemble" in name]
    assert names
    assert all(name.startswith("ensemble.") for name in names)


def test_a_trial_of_beta_trains_one_member() -> None:
    original = settings("full_vae_ensemble")
    trial = FullVaeEnsemble.trial_settings(original)
    assert trial.model_ensemble.members == 1
    assert replace(trial, model_ensemble=original.model_ensemble) == original
    assert len(FullVaeEnsemble(normalization(), trial, 0.1).member_models()) == 1


def test_members_are_trained_like_a_single_model() -> None:
    sections = FullCrpsEnsemble.settings_from(SMALL)
    options = FullCrpsEnsemble.training_options(sections)
    assert options == FullCrps.training_options(sections) != sections.train
    network = FullCrpsEnsemble(normalization(), sections)
    members = network.member_models()
    assert network.data_streams == MEMBERS
    optimizer = torch.optim.SGD(network.parameters(), 1.0)
    assert isinstance(network.schedule(optimizer, 1.0, 10), torch.optim.lr_scheduler.LambdaLR)
    assert network.resets_optimizer_at(members[0].first_rollout_step())
    assert not network.resets_optimizer_at(0)
    network.on_training_data(torch.rand(5, HORIZON + 1, STATE))
    assert network.training_size == 5
    for member in members:
        assert bool(member.decoder.lowest.isfinite().all())
    for step in (0, options.steps - 1):
        assert bool(network.losses(training_batch(network), step)["loss"].isfinite())


@pytest.mark.parametrize(
    ("change", "dependent"),
    [
        ({"model_ensemble": ModelEnsemble(members=2)}, NAMES),
        ({"probabilistic_ensemble": ProbabilisticEnsemble("step")}, ["probabilistic_ensemble"]),
    ],
)
def test_a_fit_depends_on_the_sections_of_its_model_alone(
    change: dict[str, Any], dependent: list[str]
) -> None:
    original, changed = Pipeline(Config()), Pipeline(Config(sections=change))
    cells = [Cell("uav", "low", name, 0) for name in OURS]
    differing = {
        cell.model for cell in cells if original.train(cell).key != changed.train(cell).key
    }
    assert differing == set(dependent)
