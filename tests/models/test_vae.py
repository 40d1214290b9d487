"""How the two VAEs are trained and sampled."""

from typing import Any

import numpy as np
import pytest
import torch

from study.models.networks.cvae import kl_from_standard_normal
from study.models.networks.likelihood import heteroscedastic_nll
from study.models.residual_vae import ResidualVae
from study.models.unroll.unroll import bounded
from tests.helpers.models import HORIZON, MEMBERS, STATE, batch, model, normalization

TEACHER_FORCING = ["never", "always", "scheduled"]


def vae(name: str, **values: Any) -> Any:
    """A small VAE; `values` are those of the section `vae`."""
    return model(name, vae=values)


def test_the_baseline_is_the_sampled_member() -> None:
    """ŷ_pred = ε̂_alea + ŷ_m: a decoder that outputs 0 gives ŷ_m."""
    network = vae("residual_vae")
    states, actions = batch()["states"], batch()["actions"]
    s0 = states[:, 0]
    members = network.ensemble(s0, actions)
    member = torch.tensor([0, 1, 2, 0, 1, 2, 0, 1])
    baselines = network.baselines(s0, actions, members)
    baseline, condition = network.select(baselines, actions, member[:, None])
    torch.testing.assert_close(baseline[:, 1:], members[torch.arange(8), member])
    torch.testing.assert_close(baseline[:, 0], s0)
    change = (baseline[:, 1:] - baseline[:, :-1]) / network.delta_std
    torch.testing.assert_close(condition, torch.cat([actions, baseline[:, 1:], change], -1))
    torch.testing.assert_close(network.baselines(s0, actions, None), baselines)
    network.cvae.decoder.output.weight.data.zero_()
    noise = torch.zeros(8, 1, HORIZON, network.noise_size)
    forecast = network.sample(s0, actions, noise, member[:, None])
    torch.testing.assert_close(forecast[:, 0], baseline[:, 1:])


def test_the_target_is_the_residual_to_the_sampled_member(monkeypatch: pytest.MonkeyPatch) -> None:
    """ε_alea = y_true − ŷ_m, equation (8)."""
    network, data = vae("residual_vae"), batch()
    data["members"] = torch.randn(8, MEMBERS, HORIZON, STATE)
    member = torch.tensor([0, 1, 2, 0, 1, 2, 0, 1])
    monkeypatch.setattr(network, "sample_training_members", lambda *_: member)
    encode, targets = network.cvae.encode, []

    def recorded(target: torch.Tensor, *rest: torch.Tensor) -> Any:
        targets.append(target)
        return encode(target, *rest)

    monkeypatch.setattr(network.cvae, "encode", recorded)
    network.losses(data, 0)
    expected = data["states"][:, 1:] - data["members"][torch.arange(8), member]
    torch.testing.assert_close(targets[0], expected)


def test_the_full_vae_has_a_baseline_of_zero() -> None:
    network, data = vae("full_vae"), batch()
    baselines = network.baselines(data["states"][:, 0], data["actions"], None)
    member = torch.zeros(8, 1, dtype=torch.int64)
    baseline, condition = network.select(baselines, data["actions"], member)
    assert (baseline == 0).all()
    torch.testing.assert_close(condition, data["actions"])


def test_without_an_ensemble_it_needs_the_members_forecasts() -> None:
    outer = vae("residual_vae")
    network = ResidualVae(normalization(), outer.settings, 0.1, None)
    network.load_state_dict(outer.state_dict(), strict=False)
    data, member = batch(), torch.randint(MEMBERS, (8, 2))
    s0, actions = data["states"][:, 0], data["actions"]
    noise = torch.randn(8, 2, HORIZON, outer.noise_size)
    members = outer.ensemble(s0, actions)
    found = network.generate(s0, actions, noise, member, members)
    torch.testing.assert_close(found, outer.sample(s0, actions, noise, member))
    with pytest.raises(ValueError, match="needs the members' forecasts"):
        network.sample(s0, actions, noise, member)


@pytest.mark.parametrize("teacher_forcing", TEACHER_FORCING)
def test_a_state_is_sampled_from_the_decoders_distribution(teacher_forcing: str) -> None:
    """With a decoder that outputs 0 the forecast is its baseline and the noise of p_θ.

    A decoder that is always teacher forced is fed its samples, so that the noise accumulates.
    """
    network = vae("residual_vae", teacher_forcing=teacher_forcing)
    assert network.noise_size == network.settings.vae.latent_size + STATE
    decoder = network.cvae.decoder
    decoder.output.weight.data.zero_()
    log_std = torch.tensor([0.5, -0.5, 100.0])
    decoder.log_std.bias.data.copy_(log_std)
    decoder.variance.copy_(torch.tensor([4.0, 1.0, 0.25]))
    data, member = batch(), torch.zeros(8, 2, dtype=torch.int64)
    s0, actions = data["states"][:, 0], data["actions"]
    noise = torch.randn(8, 2, HORIZON, network.noise_size)
    with torch.no_grad():
        added = network.sample(s0, actions, noise, member) - network.ensemble(s0, actions)[:, :1]
    std = torch.tensor([2.0, 1.0, 0.5]) * bounded(log_std).exp()
    one_step = noise[..., network.settings.vae.latent_size :] * std
    expected = one_step.cumsum(2) if teacher_forcing == "always" else one_step
    torch.testing.assert_close(added, expected, rtol=1e-4, atol=1e-4)


def test_a_forecast_may_be_the_mean() -> None:
    network = vae("full_vae", decoder_output="mean")
    assert network.noise_size == network.settings.vae.latent_size
    data, member = batch(), torch.zeros(8, 1, dtype=torch.int64)
    inputs = (data["states"][:, 0], data["actions"], torch.randn(8, 1, HORIZON, 4), member)
    forecast = network.sample(*inputs)
    network.cvae.decoder.variance.fill_(100.0)
    torch.testing.assert_close(network.sample(*inputs), forecast)


@pytest.mark.parametrize(
    ("teacher_forcing", "expected"),
    [("always", [True] * 10), ("never", [False] * 10), ("scheduled", [True] * 3 + [False] * 7)],
)
def test_when_the_decoder_is_teacher_forced(teacher_forcing: str, expected: list[bool]) -> None:
    network: Any = model("full_vae", vae={"teacher_forcing": teacher_forcing}, train={"steps": 10})
    assert [network.is_teacher_forced(step) for step in range(10)] == expected


@pytest.mark.parametrize("name", ["residual_vae", "full_vae"])
@pytest.mark.parametrize("teacher_forcing", ["never", "always"])
def test_the_loss_of_equation_12(name: str, teacher_forcing: str) -> None:
    network, data = vae(name, teacher_forcing=teacher_forcing), batch()
    network.cvae.decoder.log_std.weight.data.normal_(std=0.3)
    torch.manual_seed(3)
    losses = network.losses(data, 0)
    states, actions = data["states"], data["actions"]
    s0, truth = states[:, 0], states[:, 1:]
    torch.manual_seed(3)
    baselines = network.baselines(s0, actions, None)
    member = network.sample_training_members(8, baselines.shape[1], s0.device)
    baseline, condition = network.select(baselines, actions, member[:, None])
    target = truth - baseline[:, 1:]
    mean, log_variance = network.cvae.encode(target, states[:, :-1], condition)
    latent = mean + torch.randn_like(mean) * torch.exp(0.5 * log_variance)
    history = states[:, :-1] if teacher_forcing == "always" else None
    prediction, log_std = network.cvae.decode(s0, baseline, condition, latent, history)
    nll = heteroscedastic_nll(truth - prediction, log_std)[0].sum()
    divergence = kl_from_standard_normal(mean, log_variance).mean()
    torch.testing.assert_close(losses["loss/negative_log_likelihood"], nll)
    torch.testing.assert_close(losses["loss/kl"], divergence)
    torch.testing.assert_close(losses["loss"], nll + network.beta * divergence)
    assert network.beta == 0.1


def test_training_estimates_the_variance() -> None:
    network = vae("full_vae")
    torch.manual_seed(0)
    network.cvae.decoder.log_std.bias.data.fill_(1.0)
    for step in range(60):
        network.losses(batch(64), step)  # no optimiser: the error stays the same
    data, member = batch(64), torch.zeros(64, 1, dtype=torch.int64)
    s0, truth, history = data["states"][:, 0], data["states"][:, 1:], data["states"][:, :-1]
    with torch.no_grad():
        baselines = network.baselines(s0, data["actions"], None)
        baseline, condition = network.select(baselines, data["actions"], member)
        posterior, log_variance = network.cvae.encode(truth, history, condition)
        squares = []
        for _ in range(20):
            latent = posterior + torch.randn_like(posterior) * torch.exp(0.5 * log_variance)
            mean, log_std = network.cvae.decode(s0, baseline, condition, latent, history)
            squares.append(((truth - mean) / log_std.exp()).square().mean((0, 1)))
    expected = torch.stack(squares).mean(0)
    torch.testing.assert_close(network.cvae.decoder.variance, expected, rtol=0.2, atol=0.0)


@pytest.mark.parametrize("teacher_forcing", TEACHER_FORCING)
@pytest.mark.parametrize("name", ["residual_vae", "full_vae"])
def test_training_lowers_the_loss_and_leaves_the_ensemble_alone(
    name: str, teacher_forcing: str
) -> None:
    network = vae(name, teacher_forcing=teacher_forcing)
    initial = {k: v.clone() for k, v in network.state_dict().items() if k.startswith("ensemble")}
    assert bool(initial) == (name == "residual_vae")
    optimizer = torch.optim.Adam([p for p in network.parameters() if p.requires_grad], 1e-2)
    losses = []
    for step in range(25):
        loss = network.losses(batch(), step)["loss"]
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert np.mean(losses[-5:]) < np.mean(losses[:5])
    for key, value in initial.items():
        assert torch.equal(network.state_dict()[key], value)


@pytest.mark.parametrize("member", ["trajectory", "batch"])
def test_the_member_is_sampled_uniformly_in_training(member: str) -> None:
    torch.manual_seed(0)
    network, device = vae("residual_vae", member=member), torch.device("cpu")
    members = torch.stack(
        [network.sample_training_members(10, MEMBERS, device) for _ in range(300)]
    )
    shares = torch.bincount(members.flatten(), minlength=MEMBERS) / members.numel()
    assert (shares - 1 / MEMBERS).abs().max() < 0.1
    assert bool((members == members[:, :1]).all()) == (member == "batch")
