"""The statistics of a fitted VAE's posterior."""

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.distributions import Normal, kl_divergence

from study.common.errors import StudyError
from study.data.trajectories import ScenarioSet
from study.models.posterior import posterior_statistics
from study.training.data_module import TrajectoryDataModule
from study.training.inputs import VALIDATION_ROLLOUTS, validation_trajectories
from tests.helpers.models import (
    ACTION,
    HORIZON,
    MEMBERS,
    STATE,
    batch,
    model,
    normalization,
    trajectories,
)

LATENT = 4
VAES = ["residual_vae", "full_vae"]
ENSEMBLES = ["residual_vae_ensemble", "full_vae_ensemble"]


def full_batch(count: int = 8) -> dict[str, Tensor]:
    """A batch with the forecasts of an ensemble."""
    generator = torch.Generator().manual_seed(5)
    return batch(count) | {
        "members": torch.randn(count, MEMBERS, HORIZON, STATE, generator=generator)
    }


def with_posterior(network: Any, mean: list[float], log_variance: list[float]) -> Any:
    """The model with the same q_φ for every input."""
    network.cvae.posterior.weight.data.zero_()
    network.cvae.posterior.bias.data.copy_(torch.tensor([*mean, *log_variance]))
    return network


@pytest.mark.parametrize("name", VAES)
def test_a_posterior_that_is_the_prior_has_collapsed(name: str) -> None:
    network = with_posterior(model(name), [0.0] * LATENT, [0.0] * LATENT)
    statistics = posterior_statistics(network, full_batch())
    assert statistics["kl"] == pytest.approx(0, abs=1e-6)
    assert statistics["active_units"] == 0


def test_the_divergence_is_in_nats_a_step() -> None:
    """KL[N(2, e^-1) ‖ N(0, 1)] of one component, at every step."""
    network = with_posterior(model("full_vae"), [2.0, 0, 0, 0], [-1.0, 0, 0, 0])
    statistics = posterior_statistics(network, batch())
    assert statistics["kl"] == pytest.approx(0.5 * (4 + np.exp(-1) - 1 + 1), rel=1e-5)
    assert statistics["active_units"] == 0, "a mean that does not vary is no active unit"


@pytest.mark.parametrize("teacher_forcing", ["always", "never"])
@pytest.mark.parametrize("name", VAES)
def test_the_elbo_is_that_of_torch_distributions(name: str, teacher_forcing: str) -> None:
    torch.manual_seed(1)
    network: Any = model(name, vae={"teacher_forcing": teacher_forcing})
    network.cvae.decoder.log_std.weight.data.normal_(0, 0.3)
    network.cvae.decoder.variance.copy_(torch.tensor([0.5, 1.0, 2.0]))
    data = full_batch()
    states, actions = data["states"], data["actions"]
    with torch.no_grad():
        baselines = network.baselines(states[:, 0], actions, data["members"])
        member = torch.arange(len(states))[:, None] % baselines.shape[1]
        baseline, condition = network.select(baselines, actions, member)
        target = states[:, 1:] - baseline[:, 1:]
        mean, log_variance = network.cvae.encode(target, states[:, :-1], condition)
        posterior = Normal(mean, (0.5 * log_variance).exp())
        normal = torch.randn(mean.shape, generator=torch.Generator().manual_seed(0))
        latent = posterior.mean + posterior.stddev * normal
        history = states[:, :-1] if teacher_forcing == "always" else None
        means, log_std = network.cvae.decode(states[:, 0], baseline, condition, latent, history)
        forecast = Normal(means, network.cvae.decoder.variance.sqrt() * log_std.exp())
        prior = Normal(torch.zeros_like(mean), torch.ones_like(mean))
        elbo = forecast.log_prob(states[:, 1:]).sum(-1) - kl_divergence(posterior, prior).sum(-1)
    assert float(log_std.std()) > 0.01
    assert network.negative_elbo(data) == pytest.approx(-float(elbo.mean()), rel=1e-5)


def test_the_elbo_does_not_depend_on_beta_or_the_random_state() -> None:
    network: Any = model("full_vae")
    value = network.negative_elbo(batch())
    network.beta *= 100
    torch.manual_seed(99)
    assert network.negative_elbo(batch()) == value


@pytest.mark.parametrize("name", ENSEMBLES)
def test_the_elbo_of_an_ensemble_is_the_mean_over_the_members(name: str) -> None:
    network: Any = model(name)
    values = [member.negative_elbo(full_batch()) for member in network.member_models()]
    assert len(set(values)) > 1
    assert network.negative_elbo(full_batch()) == pytest.approx(np.mean(values))


def test_a_model_without_an_elbo_says_what_to_do() -> None:
    with pytest.raises(StudyError, match=r"has no negative_elbo: set tune\.objective to mmd2"):
        model("probabilistic_mlp").negative_elbo(batch())


def test_active_units_are_components_whose_mean_varies(monkeypatch: pytest.MonkeyPatch) -> None:
    network: Any = model("full_vae")
    means = torch.randn(8, HORIZON, LATENT) * torch.tensor([1.0, 0.2, 0.05, 0.0])
    monkeypatch.setattr(network.cvae, "encode", lambda *_: (means, torch.zeros_like(means)))
    assert posterior_statistics(network, batch())["active_units"] == 2


@pytest.mark.parametrize("teacher_forcing", ["always", "never"])
def test_the_share_of_the_variance_that_comes_from_the_latent_variable(
    teacher_forcing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a decoder that adds a_d z_t to its history: a² / (a² + σ²) in each dimension."""
    network: Any = model("full_vae", vae={"teacher_forcing": teacher_forcing})
    slope, variance = torch.tensor([2.0, 1.0, 0.0]), torch.tensor([1.0, 1.0, 1.0])
    histories = []

    def decode(
        s0: Tensor, baseline: Tensor, condition: Tensor, latent: Tensor, history: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        histories.append(history)
        first = latent[..., :1]
        earlier = 100 * (first.cumsum(1) - first)  # the same for all z_t
        return earlier + slope * first, torch.zeros(*first.shape[:2], STATE)

    monkeypatch.setattr(network.cvae, "decode", decode)
    network.cvae.decoder.variance.copy_(variance)
    share = posterior_statistics(network, batch(64))["latent_share"]
    assert share == pytest.approx((4 / 5 + 1 / 2 + 0) / 3, rel=0.05)
    assert all((history is None) == (teacher_forcing == "never") for history in histories)


def test_a_decoder_that_ignores_the_latent_variable_has_a_share_of_zero() -> None:
    network: Any = model("full_vae")
    for layer in (network.cvae.decoder.output, network.cvae.decoder.skip):
        layer.weight.data.zero_()
    assert posterior_statistics(network, batch())["latent_share"] == 0


@pytest.mark.parametrize("name", [*VAES, *ENSEMBLES])
def test_the_diagnostics_of_a_fit_do_not_depend_on_the_random_numbers_before(name: str) -> None:
    network = model(name)
    first = network.diagnostics(full_batch())
    torch.rand(7)
    state = torch.get_rng_state()
    assert network.diagnostics(full_batch()) == first
    assert torch.equal(torch.get_rng_state(), state), "and they leave the generator alone"
    assert set(first) == {"kl", "active_units", "latent_share"}


@pytest.mark.parametrize("name", ENSEMBLES)
def test_those_of_an_ensemble_are_the_mean_over_its_members(name: str) -> None:
    network: Any = model(name)
    for index, member in enumerate(network.member_models()):
        with_posterior(member, [float(index), 0, 0, 0], [0.0] * LATENT)
    expected = np.mean([0.5 * index**2 for index in range(MEMBERS)])
    assert network.diagnostics(full_batch())["kl"] == pytest.approx(expected, rel=1e-5)


def test_a_model_without_a_posterior_has_none() -> None:
    assert model("probabilistic_mlp").diagnostics(batch()) == {}


@pytest.mark.parametrize("name", ["residual_vae", "residual_vae_ensemble", "full_vae"])
def test_validation_trajectories_are_those_that_were_observed(name: str) -> None:
    network: Any = model(name)
    generator = np.random.default_rng(0)
    s0, actions, observed = (
        generator.normal(size=size).astype(np.float32)
        for size in ((5, STATE), (5, HORIZON, ACTION), (5, 4, HORIZON, STATE))
    )
    unobserved = np.zeros((5, 4, 0), np.float32)
    scenarios = ScenarioSet(s0, actions, np.zeros((5, 1), np.float32), observed, unobserved, {})
    data = TrajectoryDataModule(normalization(), trajectories(), scenarios, 4, 0)
    found = validation_trajectories(network, data)
    count = 5 * VALIDATION_ROLLOUTS
    assert found["states"].shape == (count, HORIZON + 1, STATE)
    states = network.denormalize(found["states"]).numpy()
    np.testing.assert_allclose(states[3, 0], s0[3 // VALIDATION_ROLLOUTS], rtol=1e-4, atol=1e-4)
    last = observed[:, :VALIDATION_ROLLOUTS].reshape(count, HORIZON, STATE)
    np.testing.assert_allclose(states[:, 1:], last, rtol=1e-4, atol=1e-4)
    assert ("members" in found) == (name != "full_vae")
    if name != "full_vae":
        expected = network.ensemble(found["states"][:, 0], found["actions"])
        torch.testing.assert_close(found["members"], expected)
    assert network.diagnostics(found)["kl"] > 0
