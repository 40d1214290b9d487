"""The residual's algebra, the loss of equation (12), and what the network may see."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.distributions import Normal, kl_divergence

from study.data.normalization import Normalization
from study.models.networks.cvae import RecurrentCvae, kl_from_standard_normal
from study.models.networks.likelihood import (
    negative_log_likelihood,
    weighted_negative_log_likelihood,
)
from study.models.residual_vae import ResidualVae
from study.models.vae import Vae
from tests.helpers.models import ACTION, HORIZON, STATE, model, trajectories

FEEDINGS = ["free", "teacher", "schedule"]


def batch(count: int = 8) -> dict[str, Tensor]:
    data = trajectories(count, seed=2)
    normalization = Normalization.of(trajectories())
    return {
        "states": normalization.normalize_states(data.states),
        "actions": normalization.normalize_actions(data.actions),
    }


def test_the_residuals_add_up() -> None:
    """Equations (5) to (8): ε_total = ε_alea + ε_epist, whatever member is drawn."""
    generator = np.random.default_rng(0)
    truth, members = generator.normal(size=(4, 3)), generator.normal(size=(5, 4, 3))
    total = truth - members.mean(0)
    for member in members:
        epistemic = member - members.mean(0)
        aleatoric = truth - member
        np.testing.assert_allclose(total, aleatoric + epistemic)


def test_the_target_is_the_residual_to_the_drawn_member() -> None:
    """ε_alea = y_true − ŷ_m, and ŝ_pred = ε̂ + ŷ_m: a decoder that returns ε_alea is exact."""
    vae = model("residual_vae")
    assert isinstance(vae, ResidualVae)
    data = batch()
    states, actions = data["states"], data["actions"]
    members = vae.ensemble(states[:, 0], actions)
    drawn = torch.tensor([0, 1, 2, 0, 1, 2, 0, 1])
    baseline, condition = vae.conditions(states[:, 0], actions, drawn[:, None], members)
    torch.testing.assert_close(baseline[:, 1:], members[torch.arange(8), drawn])
    torch.testing.assert_close(baseline[:, 0], states[:, 0])
    torch.testing.assert_close(condition, torch.cat([actions, baseline[:, 1:]], -1))
    computed, _ = vae.conditions(states[:, 0], actions, drawn[:, None], None)
    torch.testing.assert_close(computed, baseline)
    vae.cvae.decode.out.weight.data.zero_()
    vae.cvae.decode.out.bias.data.zero_()
    noise = torch.zeros(8, 1, HORIZON, vae.noise_size)
    forecast = vae.sample(states[:, 0], actions, noise, drawn[:, None])
    torch.testing.assert_close(forecast[:, 0], baseline[:, 1:])  # ε̂ = 0


def test_full_vae_has_nothing_to_add_to() -> None:
    vae = model("full_vae")
    assert isinstance(vae, Vae)
    data = batch()
    drawn = torch.zeros(8, 1, dtype=torch.int64)
    baseline, condition = vae.conditions(data["states"][:, 0], data["actions"], drawn, None)
    assert (baseline == 0).all()
    torch.testing.assert_close(condition, data["actions"])


def test_the_loss_term_by_term() -> None:
    generator = np.random.default_rng(1)
    error, log_width = generator.normal(size=(2, 3, 4, STATE))
    mean, log_variance = generator.normal(size=(2, 3, 4, 5))
    beta = 0.3
    # σ of each dimension: that under which the batch is most likely.
    scale = np.sqrt(np.square(error / np.exp(log_width)).mean(axis=(0, 1)))
    weight = np.exp(log_width) / np.exp(log_width).mean(axis=(0, 1))
    likelihood = divergence = 0.0
    for b in range(3):
        for t in range(4):
            for d in range(STATE):
                sigma = scale[d] * math.exp(log_width[b, t, d])
                minus_log = 0.5 * (error[b, t, d] / sigma) ** 2
                minus_log += math.log(sigma * math.sqrt(2 * math.pi))
                likelihood += weight[b, t, d] * minus_log
            for z in range(5):
                m, v = mean[b, t, z], math.exp(log_variance[b, t, z])
                divergence += 0.5 * (m**2 + v - 1 - math.log(v))
    likelihood, divergence = likelihood / 12, divergence / 12
    cvae = RecurrentCvae(torch.ones(STATE), ACTION, 8, 5).double()
    error, log_width, mean, log_variance = map(torch.tensor, (error, log_width, mean, log_variance))
    loss, first, second, variance = cvae.loss(error, log_width, mean, log_variance, beta)
    assert first.item() == pytest.approx(likelihood)
    assert second.item() == pytest.approx(divergence)
    assert loss.item() == pytest.approx(likelihood + beta * divergence)
    np.testing.assert_allclose(variance, scale**2)


def test_kl_and_likelihood_against_torch_distributions() -> None:
    torch.manual_seed(0)
    mean, log_variance = torch.randn(2, 6, 3).double().unbind(0)
    posterior = Normal(mean, torch.exp(0.5 * log_variance))
    prior = Normal(torch.zeros_like(mean), torch.ones_like(mean))
    expected = kl_divergence(posterior, prior).sum(-1)
    torch.testing.assert_close(kl_from_standard_normal(mean, log_variance), expected)


def test_the_likelihood_is_that_of_the_best_scale() -> None:
    """Against torch.distributions: no other σ gives less, and a dimension's unit does not count."""
    torch.manual_seed(0)
    truth, mean = torch.randn(2, 50, 3).double().unbind(0)
    squares = (truth - mean).square().mean(0)
    found = negative_log_likelihood(squares)

    def at(scale: torch.Tensor) -> torch.Tensor:
        return -Normal(mean, scale).log_prob(truth).mean(0)

    torch.testing.assert_close(found, at(squares.sqrt()))
    for factor in (0.9, 1.1):
        assert (at(factor * squares.sqrt()) > found).all()
    unit = torch.tensor([1e-3, 1.0, 50.0]).double()
    squares.requires_grad_()
    gradient = torch.autograd.grad(negative_log_likelihood(squares * unit**2).sum(), squares)[0]
    torch.testing.assert_close(gradient, 0.5 / squares.detach())


def test_of_one_width_the_weighted_likelihood_is_the_other() -> None:
    torch.manual_seed(0)
    error = torch.randn(6, 5, 3).double().requires_grad_()
    found, variance = weighted_negative_log_likelihood(error, torch.zeros_like(error))
    expected = negative_log_likelihood(error.square().mean((0, 1)))
    torch.testing.assert_close(found, expected)
    torch.testing.assert_close(variance, error.detach().square().mean((0, 1)))
    ours, theirs = (torch.autograd.grad(each.sum(), error)[0] for each in (found, expected))
    torch.testing.assert_close(ours, theirs)


def test_the_best_width_is_the_noises() -> None:
    """The weights of the β-NLL do not move its minimum: σ e^w is each step's own noise."""
    torch.manual_seed(0)
    noise = torch.tensor([0.5, 1.0, 2.0]).double()
    error = torch.randn(10_000, 3, 1).double() * noise[:, None]
    log_width = torch.zeros(3, 1).double().requires_grad_()
    optimizer = torch.optim.Adam([log_width], 0.05)
    for _ in range(200):
        found, variance = weighted_negative_log_likelihood(error, log_width.expand_as(error))
        optimizer.zero_grad()
        found.sum().backward()
        optimizer.step()
    width = variance.sqrt() * torch.exp(log_width.detach()[:, 0])
    torch.testing.assert_close(width, noise, rtol=0.03, atol=0.0)


@pytest.mark.parametrize("feeding", FEEDINGS)
def test_a_state_is_drawn_from_the_decoders_distribution(feeding: str) -> None:
    """With a decoder that gives ε̂ = 0 the forecast is its baseline and the noise of p_θ.

    A taught decoder goes on from what was drawn, so that the noise of increments adds up.
    """
    vae = model("residual_vae", feeding=feeding)
    assert isinstance(vae, ResidualVae)
    assert vae.noise_size == vae.latent_size + STATE
    decode = vae.cvae.decode
    decode.out.weight.data.zero_()
    decode.out.bias.data.zero_()
    decode.width.bias.data.copy_(torch.tensor([0.5, -0.5, 100.0]))
    decode.variance.copy_(torch.tensor([4.0, 1.0, 0.25]))
    data, drawn = batch(), torch.zeros(8, 2, dtype=torch.int64)
    s0, actions = data["states"][:, 0], data["actions"]
    noise = torch.randn(8, 2, HORIZON, vae.noise_size)
    with torch.no_grad():
        added = vae.sample(s0, actions, noise, drawn) - vae.ensemble(s0, actions)[:, :1]
    factor = torch.tensor([2.0, 1.0, 0.5]) * torch.tensor([0.5, -0.5, 100.0]).tanh().exp()
    each = noise[..., vae.latent_size :] * factor
    expected = each.cumsum(2) if feeding == "teacher" else each
    torch.testing.assert_close(added, expected, rtol=1e-4, atol=1e-4)


def test_a_forecasts_noise_is_as_wide_as_the_likelihood_says() -> None:
    """One step of `draw` against the mean and the width that `distribution` gives."""
    torch.manual_seed(0)
    decode = RecurrentCvae(torch.ones(STATE), ACTION, 8, 4, increments=True).decode
    decode.width.weight.data.normal_()
    decode.variance.copy_(torch.tensor([4.0, 1.0, 0.25]))
    s0, baseline = torch.randn(5, STATE), torch.randn(5, HORIZON + 1, STATE)
    condition, latent = torch.randn(5, HORIZON, ACTION), torch.randn(5, HORIZON, 4)
    normal = torch.randn(5, HORIZON, STATE)
    drawn = decode.draw(s0, baseline, condition, latent, normal)
    history = torch.cat([s0[:, None], drawn[:, :-1]], dim=1)
    mean, log_width = decode.distribution(s0, baseline, condition, latent, history)
    assert log_width.std() > 0.1
    scale = decode.variance.sqrt() * torch.exp(log_width)
    torch.testing.assert_close(drawn, mean + scale * normal, rtol=1e-4, atol=1e-4)


def test_a_fixed_width_is_not_learned() -> None:
    vae = model("full_vae", width="fixed")
    assert isinstance(vae, Vae)
    vae.losses(batch(), 0)["loss"].backward()
    decode = vae.cvae.decode
    assert decode.width.weight.grad is None
    s0, zeros = torch.randn(2, STATE), torch.zeros(2, HORIZON + 1, STATE)
    condition, latent = torch.randn(2, HORIZON, ACTION), torch.randn(2, HORIZON, 4)
    _, log_width = decode.distribution(s0, zeros, condition, latent)
    assert (log_width == 0).all()
    assert decode.out.weight.grad is not None


def test_a_forecast_may_be_the_mean() -> None:
    vae = model("full_vae", forecast="mean")
    assert isinstance(vae, Vae)
    assert vae.noise_size == vae.latent_size
    data, member = batch(), torch.zeros(8, 1, dtype=torch.int64)
    given = (data["states"][:, 0], data["actions"], torch.randn(8, 1, HORIZON, 4), member)
    forecast = vae.sample(*given)
    vae.cvae.decode.variance.fill_(100.0)
    torch.testing.assert_close(vae.sample(*given), forecast)


def test_the_scale_is_remembered_over_batches() -> None:
    """The first batch gives σ² alone, later ones their share; and it is kept with the weights."""
    decode = RecurrentCvae(torch.ones(STATE), ACTION, 8, 4).decode
    variance = torch.tensor([1.0, 4.0, 9.0])
    decode.remember(variance, 1.0)
    torch.testing.assert_close(decode.variance, variance)
    decode.remember(torch.zeros(STATE), 0.25)
    torch.testing.assert_close(decode.variance, 0.75 * variance)
    assert "variance" in decode.state_dict()


def test_training_measures_the_scale() -> None:
    vae = model("full_vae")
    assert isinstance(vae, Vae)
    torch.manual_seed(0)
    vae.cvae.decode.width.bias.data.fill_(1.0)
    for step in range(60):
        vae.losses(batch(64), step)  # no optimiser: the error stays as it is
    data = batch(64)
    with torch.no_grad():
        baseline, condition = vae.conditions(
            data["states"][:, 0], data["actions"], torch.zeros(64, 1, dtype=torch.int64), None
        )
        truth = data["states"][:, 1:]
        latent = vae.cvae.encode(truth, data["states"][:, :-1], condition)[0]
        given = (data["states"][:, 0], baseline, condition, latent, data["states"][:, :-1])
        error = truth - vae.cvae.decode(*given)
    expected = (error / math.exp(math.tanh(1.0))).square().mean((0, 1))
    torch.testing.assert_close(vae.cvae.decode.variance, expected, rtol=0.2, atol=0.0)


@pytest.mark.parametrize("increments", [True, False])
@pytest.mark.parametrize("taught", [True, False])
def test_the_decoder_is_causal(taught: bool, increments: bool) -> None:
    """Changing a_t, z_t or s_t never changes a prediction ŝ at or before t."""
    torch.manual_seed(0)
    cvae = RecurrentCvae(torch.ones(STATE), ACTION, 8, 4, increments)
    s0, baseline = torch.randn(2, STATE), torch.randn(2, HORIZON + 1, STATE)
    known = {
        "condition": torch.randn(2, HORIZON, ACTION),
        "latent": torch.randn(2, HORIZON, 4),
        "truth": torch.randn(2, HORIZON, STATE),
    }
    if not taught:
        del known["truth"]
    reference = cvae.decode(s0, baseline, **known)
    for name in known:
        for step in range(1, HORIZON):
            changed = known | {name: known[name].clone()}
            changed[name][:, step] += 1.0
            prediction = cvae.decode(s0, baseline, **changed)
            # ŝ_1 … ŝ_t are made before s_t, a_t and z_t are seen.
            torch.testing.assert_close(prediction[:, :step], reference[:, :step])
            assert not torch.allclose(prediction[:, step], reference[:, step])


@pytest.mark.parametrize("increments", [True, False])
def test_teacher_forcing_with_its_own_predictions_is_free_running(increments: bool) -> None:
    torch.manual_seed(0)
    cvae = RecurrentCvae(torch.ones(STATE), ACTION, 8, 4, increments)
    s0, baseline = torch.randn(2, STATE), torch.randn(2, HORIZON + 1, STATE)
    condition, latent = torch.randn(2, HORIZON, ACTION), torch.randn(2, HORIZON, 4)
    free = cvae.decode(s0, baseline, condition, latent)
    history = torch.cat([s0[:, None], free[:, :-1]], dim=1)
    taught = cvae.decode(s0, baseline, condition, latent, history)
    torch.testing.assert_close(taught, free)


@pytest.mark.parametrize("sees_target", [True, False])
def test_the_encoder_is_causal(sees_target: bool) -> None:
    torch.manual_seed(0)
    cvae = RecurrentCvae(torch.ones(STATE), ACTION, 8, 4, sees_target=sees_target)
    inputs = [torch.randn(2, HORIZON, n) for n in (STATE, STATE, ACTION)]
    reference, _ = cvae.encode(*inputs)
    for position in range(3):
        changed = [tensor.clone() for tensor in inputs]
        changed[position][:, 3] += 1.0
        mean, _ = cvae.encode(*changed)
        torch.testing.assert_close(mean[:, :3], reference[:, :3])
        sees = sees_target or position > 0
        assert torch.allclose(mean[:, 3:], reference[:, 3:]) != sees


@pytest.mark.parametrize("feeding", FEEDINGS)
@pytest.mark.parametrize("name", ["residual_vae", "full_vae"])
def test_training_lowers_the_loss_and_leaves_the_ensemble_alone(
    name: str, feeding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    vae = model(name, feeding=feeding)
    monkeypatch.setattr(vae, "log_dict", lambda *_, **__: None)
    before = {k: v.clone() for k, v in vae.state_dict().items() if k.startswith("ensemble")}
    optimizer = torch.optim.Adam([p for p in vae.parameters() if p.requires_grad], 1e-2)
    losses = []
    for _ in range(25):
        loss = vae.training_step(batch())
        assert isinstance(loss, Tensor)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss))
    assert np.mean(losses[-5:]) < np.mean(losses[:5])
    for key, value in before.items():
        torch.testing.assert_close(vae.state_dict()[key], value)


@pytest.mark.parametrize("how", ["sample", "batch"])
def test_the_member_is_drawn_uniformly_in_training(how: str) -> None:
    torch.manual_seed(0)
    vae = model("residual_vae", member=how)
    assert isinstance(vae, Vae)
    drawn = torch.stack([vae.draw_training_members(10, torch.device("cpu")) for _ in range(300)])
    shares = torch.bincount(drawn.flatten(), minlength=3) / drawn.numel()
    assert (shares - 1 / 3).abs().max() < 0.1
    assert bool((drawn == drawn[:, :1]).all()) == (how == "batch")
