"""The recurrent decoder: causal, consistent, and its noise has the variance of its likelihood."""

import pytest
import torch
from torch import Tensor

from study.models.networks.decoder import GaussianDecoder
from tests.helpers.models import ACTION, HORIZON, STATE

LATENT, ROWS = 4, 5


def decoder(delta_target: bool = False, homoscedastic: bool = False) -> GaussianDecoder:
    torch.manual_seed(0)
    built = GaussianDecoder(torch.ones(STATE), ACTION, 8, LATENT, delta_target, homoscedastic)
    if not homoscedastic:
        built.log_std.weight.data.normal_()
    return built


def inputs() -> dict[str, Tensor]:
    return {
        "s0": torch.randn(ROWS, STATE),
        "baseline": torch.randn(ROWS, HORIZON + 1, STATE),
        "condition": torch.randn(ROWS, HORIZON, ACTION),
        "latent": torch.randn(ROWS, HORIZON, LATENT),
    }


@pytest.mark.parametrize("delta_target", [True, False])
@pytest.mark.parametrize("teacher_forced", [True, False])
def test_it_is_causal(teacher_forced: bool, delta_target: bool) -> None:
    """ŝ_1 … ŝ_t do not depend on c_t, z_t and s_t, and ŝ_{t+1} does."""
    decode, values = decoder(delta_target), inputs()
    if teacher_forced:
        values["truth"] = torch.randn(ROWS, HORIZON, STATE)
    reference = torch.stack(decode(**values))
    for name in set(values) - {"s0", "baseline"}:
        for step in range(1, HORIZON):
            changed = values | {name: values[name].clone()}
            changed[name][:, step] += 1.0
            results = torch.stack(decode(**changed))
            torch.testing.assert_close(results[:, :, :step], reference[:, :, :step])
            assert not torch.allclose(results[0, :, step], reference[0, :, step])


@pytest.mark.parametrize("delta_target", [True, False])
def test_teacher_forcing_with_its_own_predictions_changes_nothing(delta_target: bool) -> None:
    decode, values = decoder(delta_target), inputs()
    mean, log_std = decode(**values)
    history = torch.cat([values["s0"][:, None], mean[:, :-1]], dim=1)
    forced_mean, forced_log_std = decode(**values, truth=history)
    torch.testing.assert_close(forced_mean, mean)
    torch.testing.assert_close(forced_log_std, log_std)


@pytest.mark.parametrize("delta_target", [True, False])
def test_the_baseline_is_added(delta_target: bool) -> None:
    """Where the network outputs 0, the target stays at 0, or at its first value s_0 − b_0."""
    decode, values = decoder(delta_target), inputs()
    torch.nn.init.zeros_(decode.output.weight)
    torch.nn.init.zeros_(decode.output.bias)
    mean, _ = decode(**values)
    baseline = values["baseline"]
    target = (values["s0"] - baseline[:, 0])[:, None] if delta_target else 0.0
    torch.testing.assert_close(mean, baseline[:, 1:] + target)


@pytest.mark.parametrize("delta_target", [True, False])
def test_the_noise_of_a_sample_has_the_variance_of_the_likelihood(delta_target: bool) -> None:
    decode, values = decoder(delta_target), inputs()
    decode.variance.copy_(torch.tensor([4.0, 1.0, 0.25]))
    normal = torch.randn(ROWS, HORIZON, STATE)
    sampled = decode.sample(**values, normal=normal)
    history = torch.cat([values["s0"][:, None], sampled[:, :-1]], dim=1)
    mean, log_std = decode(**values, truth=history)
    assert log_std.std() > 0.1
    std = decode.variance.sqrt() * torch.exp(log_std)
    torch.testing.assert_close(sampled, mean + std * normal, rtol=1e-4, atol=1e-4)


def test_a_homoscedastic_variance_is_not_learned() -> None:
    decode = decoder(homoscedastic=True)
    mean, log_std = decode(**inputs())
    assert (log_std == 0).all()
    mean.sum().backward()
    assert decode.output.weight.grad is not None
    assert not decode.log_std.weight.requires_grad


def test_the_variance_is_a_running_mean() -> None:
    """A rate of 1 replaces it; and it is saved with the weights."""
    decode, variance = decoder(), torch.tensor([1.0, 4.0, 9.0])
    decode.update_variance(variance, 1.0)
    torch.testing.assert_close(decode.variance, variance)
    decode.update_variance(torch.zeros(STATE), 0.25)
    torch.testing.assert_close(decode.variance, 0.75 * variance)
    assert "variance" in decode.state_dict()
