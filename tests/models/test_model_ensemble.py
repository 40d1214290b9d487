"""Ensembles of whole models: one member a sample, members that do not know of each other."""

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from study.commands.parser import parse
from study.common.seeds import spawn
from study.config.grid import Cell
from study.data.normalization import Normalization
from study.models.forecasting import forecast_members, members_of
from study.models.full_crps import FullCrps
from study.models.model_ensemble import EnsembleOf
from study.workflow.pipeline import Pipeline
from tests.helpers.models import ACTION, HORIZON, STATE, model, settings, trajectories

NAMES = ["full_vae_ensemble", "residual_vae_ensemble", "probabilistic_ensemble"]
MEMBERS = 3


def ensemble_of(name: str, **settings: Any) -> EnsembleOf:
    made = model(name, **settings)
    assert isinstance(made, EnsembleOf)
    return made


def telling(propagation: str = "trajectory") -> EnsembleOf:
    """An ensemble of MLPs that shows which member was at work: m adds m in each step, exactly."""
    network = ensemble_of("probabilistic_ensemble", propagation=propagation)
    network.delta_std.fill_(1.0)
    for index, member in enumerate(network.each()):
        member.delta_std.fill_(1.0)
        last = member.network[-1]
        torch.nn.init.zeros_(last.weight)
        torch.nn.init.zeros_(last.bias)
        last.bias.data[:STATE] = index
        member.highest.data.fill_(-50.0)
        member.lowest.data.fill_(-60.0)
    return network


def at_work(network: EnsembleOf, noise: Tensor, member: Tensor) -> Tensor:
    """The member that each step of `telling`'s forecasts is of [S, K, T]."""
    given = torch.zeros(len(noise), STATE), torch.zeros(len(noise), HORIZON, ACTION)
    states = network.sample(*given, noise, member)
    changes = torch.diff(states, dim=2, prepend=torch.zeros_like(states[:, :, :1]))
    return changes[..., 0].round().long()


def training_batch(network: EnsembleOf) -> dict[str, Tensor]:
    torch.manual_seed(1)
    batch = {
        "states": torch.randn(MEMBERS, 8, HORIZON + 1, STATE),
        "actions": torch.randn(MEMBERS, 8, HORIZON, ACTION),
    }
    if network.uses_ensemble:
        batch["members"] = torch.randn(MEMBERS, 8, 3, HORIZON, STATE)
    return batch


def gradients(network: EnsembleOf, batch: dict[str, Tensor]) -> list[list[Tensor]]:
    """Of each member, with the same draws."""
    network.zero_grad()
    torch.manual_seed(2)
    network.losses(batch, 0)["loss"].backward()
    return [
        [p.grad.clone() for p in member.parameters() if p.grad is not None]
        for member in network.each()
    ]


@pytest.mark.parametrize("name", NAMES)
def test_a_sample_is_that_of_its_member_alone(name: str) -> None:
    network, count = ensemble_of(name), ensemble_of(name).members_count()
    torch.manual_seed(0)
    s0, actions = torch.randn(2, STATE), torch.randn(2, HORIZON, ACTION)
    noise = torch.randn(2, 1, HORIZON, network.noise_size).expand(-1, count, -1, -1)
    member = torch.stack([torch.arange(count), torch.randperm(count)])
    forecasts = network.sample(s0, actions, noise, member)
    for scenario in range(2):
        one = slice(scenario, scenario + 1)
        for k, drawn in enumerate(member[scenario].tolist()):
            # Of residual VAEs both are drawn: which of them, and the recurrent network.
            recurrent = 3 if name.startswith("residual") else 1
            own, inner = divmod(drawn, recurrent)
            alone = network.each()[own].sample(
                s0[one], actions[one], noise[one, :1], torch.tensor([[inner]])
            )
            torch.testing.assert_close(forecasts[scenario, k], alone[0, 0], rtol=1e-4, atol=1e-5)
    # The noise was the same: only the members differ, and every two of them do.
    first = forecasts[0].detach().numpy()
    apart = np.abs(first[:, None] - first).max((2, 3)) + np.eye(count)
    assert apart.min() > 1e-4


@pytest.mark.parametrize(
    ("name", "settings", "count"),
    [
        ("full_vae_ensemble", {}, MEMBERS),
        ("residual_vae_ensemble", {}, 3 * MEMBERS),
        ("probabilistic_ensemble", {}, MEMBERS),
        ("probabilistic_ensemble", {"propagation": "step"}, 1),
    ],
)
def test_members_are_known_where_they_last(name: str, settings: Any, count: int) -> None:
    network = ensemble_of(name, **settings)
    assert network.members_count() == count
    member = members_of(network, spawn(0, 20), 10)
    if count == 1:
        assert member is None
    else:
        assert member is not None
        assert set(member.ravel()) == set(range(count))


def test_the_members_that_are_told_are_those_at_work() -> None:
    """The variance is split by `members_of`: it has to be what the forecast drew."""
    network, data, seeds = telling(), trajectories(5, seed=1), spawn(7, 5)
    forecasts = network.forecast(data.states[:, 0], data.actions, 8, seeds)
    changes = np.diff(forecasts, axis=2) / network.state_scale.numpy()
    member = members_of(network, seeds, 8)
    assert member is not None
    np.testing.assert_allclose(
        changes[..., 0], np.repeat(member[..., None], HORIZON - 1, 2), atol=1e-3
    )


def test_ts_infinity_keeps_its_member_and_ts1_does_not() -> None:
    torch.manual_seed(0)
    member = torch.randint(MEMBERS, (40, 10))
    noise = torch.randn(40, 10, HORIZON, STATE)
    kept = at_work(telling(), noise, member)
    torch.testing.assert_close(kept, member[:, :, None].expand_as(kept))
    chance = torch.randn(40, 10, HORIZON, 1)
    drawn = at_work(telling("step"), torch.cat([noise, chance], -1), member)
    # Uniform, and one step tells nothing of the next.
    joint = torch.bincount((drawn[..., :-1] * MEMBERS + drawn[..., 1:]).flatten(), minlength=9)
    shares = joint / joint.sum()
    assert ((shares - 1 / 9).abs() < 5 * (1 / 9 / joint.sum()) ** 0.5).all()
    # The normal number decides, and it alone; its thirds are the members.
    third = 0.430727  # Φ⁻¹(2/3)
    expected = (chance[..., 0] > -third).long() + (chance[..., 0] > third).long()
    torch.testing.assert_close(drawn, expected)


def test_the_rarest_number_has_a_member() -> None:
    network: Any = telling("step")
    drawn = network.drawn(torch.tensor([-40.0, 40.0]))
    assert drawn.tolist() == [0, MEMBERS - 1]


@pytest.mark.parametrize("name", NAMES)
def test_a_member_learns_from_its_own_data_alone(name: str) -> None:
    network = ensemble_of(name)
    batch = training_batch(network)
    before = gradients(network, batch)
    assert all(len(own) for own in before)
    other = {key: values.clone() for key, values in batch.items()}
    other["states"][1] *= 3.0
    after = gradients(network, other)
    for index in range(MEMBERS):
        same = [torch.equal(x, y) for x, y in zip(before[index], after[index], strict=True)]
        assert all(same) == (index != 1)


@pytest.mark.parametrize("name", NAMES)
def test_a_large_gradient_slows_no_other_member_down(name: str) -> None:
    network = ensemble_of(name)
    gradients(network, training_batch(network))
    norms = []
    for index, member in enumerate(network.each()):
        own = [p.grad for p in member.parameters() if p.grad is not None]
        norm = torch.nn.utils.get_total_norm(own)
        for gradient in own:  # half the limit, but for member 1's
            gradient *= (1e3 if index == 1 else 0.5) / norm
    network.configure_gradient_clipping(None, 1.0, "norm")
    for member in network.each():
        own = [p.grad for p in member.parameters() if p.grad is not None]
        norms.append(float(torch.nn.utils.get_total_norm(own)))
    assert norms == pytest.approx([0.5, 1.0, 0.5], rel=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_training_lowers_every_members_loss(name: str) -> None:
    network = ensemble_of(name)
    batch = training_batch(network)
    optimizer = torch.optim.Adam([p for p in network.parameters() if p.requires_grad], 1e-2)
    lent = {k: v.clone() for k, v in network.state_dict().items() if k.startswith("ensemble")}
    told = []
    for step in range(30):
        losses = network.losses(batch, step)
        optimizer.zero_grad()
        losses["loss"].backward()
        optimizer.step()
        told.append([float(losses[f"loss/member_{m}"].detach()) for m in range(MEMBERS)])
        assert float(losses["loss"].detach()) == pytest.approx(sum(told[-1]), rel=1e-5)
    assert (np.mean(told[-5:], axis=0) < np.mean(told[:5], axis=0)).all()
    for key, values in lent.items():
        assert torch.equal(network.state_dict()[key], values)


def test_the_recurrent_networks_are_in_the_file_once() -> None:
    network = ensemble_of("residual_vae_ensemble")
    names = [name for name in network.state_dict() if "ensemble" in name]
    assert names
    assert all(name.startswith("ensemble.") for name in names)


def test_a_trial_of_beta_fits_one_member() -> None:
    network = ensemble_of("full_vae_ensemble")
    assert len(network.each()) == MEMBERS
    settings = type(network).trial_settings(network.settings)
    assert settings["model_ensemble"]["members"] == 1
    assert network.settings["model_ensemble"]["members"] == MEMBERS


@pytest.mark.parametrize("name", NAMES)
def test_the_members_own_forecasts(name: str) -> None:
    """Without noise: what a recording shows thick."""
    network, data = ensemble_of(name), trajectories(4, seed=1)
    own = forecast_members(network, data.states[:, 0], data.actions)
    assert own.shape == (4, MEMBERS, HORIZON, STATE)
    standard = network.normalize(
        torch.from_numpy(data.states[:, 0]), torch.from_numpy(data.actions)
    )
    noise = torch.zeros(4, 1, HORIZON, network.noise_size)
    first = torch.zeros(4, 1, dtype=torch.int64)
    each = [member.sample(*standard, noise, first) for member in network.each()]
    recurrent: Any = network.ensemble if network.uses_ensemble else None
    expected = torch.cat(each, dim=1) if recurrent is None else recurrent(*standard)
    found = network.normalize_states(torch.from_numpy(own))
    torch.testing.assert_close(found, expected.detach(), rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("change", "of"),
    [("model_ensemble.members=2", NAMES), ("probabilistic_ensemble.propagation=step", NAMES[2:])],
)
def test_settings_are_those_of_their_models_alone(change: str, of: list[str]) -> None:
    before, after = (Pipeline(parse(["all", *flags]).config) for flags in ([], [f"--{change}"]))
    models = ["residual_vae", "full_vae", "probabilistic_mlp", "residual_crps", *NAMES]
    cells = [Cell("uav", "low", name, 0) for name in models]
    changed = {cell.model for cell in cells if before.train(cell).key != after.train(cell).key}
    assert changed == set(of)


class GeneratorEnsemble(EnsembleOf):
    """As a user might write it."""

    member_class = FullCrps
    sections = ("model_ensemble", *FullCrps.sections)


def test_members_are_fitted_as_one_of_their_class_would_be() -> None:
    sections = settings()
    budget = GeneratorEnsemble.budget(sections)
    assert budget == FullCrps.budget(sections) != sections["train"]
    made = GeneratorEnsemble(Normalization.of(trajectories()), sections | {"train": budget})
    optimizer = torch.optim.SGD(made.parameters(), 1.0)
    assert isinstance(made.schedule(optimizer, 1.0, 10), torch.optim.lr_scheduler.LambdaLR)
    assert made.forgets(made.each()[0].first_free())
    assert not made.forgets(0)
    made.see(torch.rand(5, HORIZON + 1, STATE))
    for member in made.each():
        assert bool(member.decode.lowest.isfinite().all())
    batch = {
        "states": torch.rand(3, 4, HORIZON + 1, STATE),
        "actions": torch.rand(3, 4, HORIZON, 2),
    }
    for step in (0, budget["steps"] - 1):
        assert bool(made.losses(batch, step)["loss"].isfinite())
