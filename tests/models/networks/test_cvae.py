"""The recurrent CVAE: its KL divergence, its baseline, and what its outputs may depend on."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn
from torch.distributions import Normal, kl_divergence

from study.models.networks.cvae import RecurrentCvae, kl_from_standard_normal
from tests.helpers.models import ACTION, HORIZON, STATE
from tests.helpers.networks import ROWS, architecture, randomize, units

LATENT = 4


def cvae(delta: bool = True, uses_target: bool = True, product: bool = True) -> RecurrentCvae:
    torch.manual_seed(0)
    shape = replace(architecture(product=product), inputs=ACTION + LATENT, start=ACTION)
    shape = replace(shape, delta=delta)
    built = RecurrentCvae(units(), shape, LATENT, uses_target=uses_target)
    randomize(built.decoder)
    return built


def decoder_inputs() -> dict[str, Tensor]:
    return {
        "s0": torch.randn(ROWS, STATE),
        "baseline": torch.randn(ROWS, HORIZON + 1, STATE),
        "condition": torch.randn(ROWS, HORIZON, ACTION),
        "latent": torch.randn(ROWS, HORIZON, LATENT),
    }


def test_the_kl_divergence_against_torch_distributions() -> None:
    torch.manual_seed(0)
    mean, log_variance = torch.randn(2, 6, 3).double().unbind(0)
    posterior = Normal(mean, torch.exp(0.5 * log_variance))
    prior = Normal(torch.zeros_like(mean), torch.ones_like(mean))
    expected = kl_divergence(posterior, prior).sum(-1)
    torch.testing.assert_close(kl_from_standard_normal(mean, log_variance), expected)


@pytest.mark.parametrize("uses_target", [True, False])
def test_the_encoder_is_causal(uses_target: bool) -> None:
    """It sees targets, states and conditions up to step t; without `uses_target` no targets."""
    network = cvae(uses_target=uses_target)
    inputs = [torch.randn(2, HORIZON, size) for size in (STATE, STATE, ACTION)]
    expected = torch.cat(network.encode(*inputs), -1)
    assert expected.shape == (2, HORIZON, 2 * LATENT)
    for position in range(3):
        changed = [tensor.clone() for tensor in inputs]
        changed[position][:, 3] += 1.0
        found = torch.cat(network.encode(*changed), -1)
        torch.testing.assert_close(found[:, :3], expected[:, :3])
        is_input = uses_target or position > 0
        for step in range(3, HORIZON):
            assert torch.allclose(found[:, step], expected[:, step]) != is_input


@pytest.mark.parametrize("product", [True, False])
@pytest.mark.parametrize("delta", [True, False])
@pytest.mark.parametrize("teacher_forced", [True, False])
def test_the_decoder_is_causal(teacher_forced: bool, delta: bool, product: bool) -> None:
    """ŝ_1 … ŝ_t do not depend on c_t, z_t, b_{t+1} and s_t; ŝ_{t+1} does."""
    network, values = cvae(delta, product=product), decoder_inputs()
    if teacher_forced:
        values["truth"] = torch.randn(ROWS, HORIZON, STATE)
    expected = torch.stack(network.decode(**values))
    for name in set(values) - {"s0"}:
        for step in range(1, HORIZON):
            changed = values | {name: values[name].clone()}
            changed[name][:, step + (name == "baseline")] += 1.0
            found = torch.stack(network.decode(**changed))
            torch.testing.assert_close(found[:, :, :step], expected[:, :, :step])
            assert not torch.allclose(found[0, :, step], expected[0, :, step])


@pytest.mark.parametrize("delta", [True, False])
def test_teacher_forcing_with_its_own_predictions_changes_nothing(delta: bool) -> None:
    network, values = cvae(delta), decoder_inputs()
    mean, log_std = network.decode(**values)
    history = torch.cat([values["s0"][:, None], mean[:, :-1]], dim=1)
    forced_mean, forced_log_std = network.decode(**values, truth=history)
    torch.testing.assert_close(forced_mean, mean, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(forced_log_std, log_std, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("delta", [True, False])
def test_the_baseline_is_added(delta: bool) -> None:
    """Where the network outputs 0, the target stays at 0, or at its first value s_0 − b_0."""
    network, values = cvae(delta), decoder_inputs()
    for parameter in (network.decoder.output.weight, network.decoder.output.bias):
        nn.init.zeros_(parameter)
    nn.init.zeros_(network.decoder.skip.weight)
    assert network.decoder.start_skip is not None
    nn.init.zeros_(network.decoder.start_skip.weight)
    mean, _ = network.decode(**values)
    baseline = values["baseline"]
    target = (values["s0"] - baseline[:, 0])[:, None] if delta else 0.0
    torch.testing.assert_close(mean, baseline[:, 1:] + target)


@pytest.mark.parametrize("delta", [True, False])
def test_the_noise_of_a_sample_has_the_variance_of_the_likelihood(delta: bool) -> None:
    network, values = cvae(delta), decoder_inputs()
    network.decoder.variance.copy_(torch.tensor([0.4, 0.1, 0.025]))
    normal = torch.randn(ROWS, HORIZON, STATE)
    sampled = network.sample(**values, normal=normal)
    history = torch.cat([values["s0"][:, None], sampled[:, :-1]], dim=1)
    mean, log_std = network.decode(**values, truth=history)
    assert log_std.std() > 0.1
    std = network.decoder.variance.sqrt() * torch.exp(log_std)
    torch.testing.assert_close(sampled, mean + std * normal, rtol=1e-4, atol=1e-4)


def test_the_memory_starts_from_s0_and_the_first_condition() -> None:
    """Through h_0 alone, c_0 acts on later states."""
    network, values = cvae(), decoder_inputs()
    network.decoder.gates.weight.data[:, STATE : STATE + ACTION] = 0
    network.decoder.skip.weight.data[:, STATE : STATE + ACTION] = 0
    network.decoder.stem.weight.data[:, STATE : STATE + ACTION] = 0
    expected, _ = network.decode(**values)
    values["condition"][:, 1:] += 1.0
    torch.testing.assert_close(network.decode(**values)[0], expected)
    values["condition"][:, 0] += 1.0
    assert not torch.allclose(network.decode(**values)[0], expected, atol=1e-3)
