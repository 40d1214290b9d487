"""The feedforward decoder of the CRPS models."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from study.models.networks.transition import GRADIENT_DECAY, RANGE_MARGIN, TransitionDecoder
from tests.helpers.models import normalization

ROWS, STEPS, SIZE, CONDITION, NOISE, PERSISTENT = 4, 9, 3, 2, 5, 2


def untrained_decoder(rotating: bool = False) -> TransitionDecoder:
    torch.manual_seed(0)
    pairs = np.array([[0, 1, 2]] if rotating else []).reshape(-1, 3).astype(np.int64)
    delta_std = np.array([0.1, 0.2, 0.3], np.float32)
    units = replace(normalization(), rotating_pairs=pairs, delta_std=delta_std)
    return TransitionDecoder(units, CONDITION, 16, NOISE, PERSISTENT)


def decoder(rotating: bool = False) -> TransitionDecoder:
    """A decoder whose output depends on all inputs."""
    built = untrained_decoder(rotating)
    torch.nn.init.normal_(built.skip.weight, std=0.1)
    torch.nn.init.normal_(built.gates.weight, std=0.3)
    return built


def inputs() -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """s_0, b_{0:T}, c_{0:T-1} and noise."""
    return (
        torch.randn(ROWS, SIZE),
        torch.randn(ROWS, STEPS + 1, SIZE),
        torch.randn(ROWS, STEPS, CONDITION),
        torch.randn(ROWS, STEPS, NOISE),
    )


def set_output_to_zero(decode: TransitionDecoder) -> None:
    for parameter in (decode.skip.weight, decode.output.weight, decode.noise_shift.weight):
        torch.nn.init.zeros_(parameter)


@pytest.mark.parametrize("rotating", [False, True])
def test_a_forecast_step_has_the_distribution_of_transition(rotating: bool) -> None:
    """Where u and v do not depend on s_0, and without persistent noise."""
    decode, (s0, baseline, condition, noise) = decoder(rotating), inputs()
    decode.gates.weight.data[:, -SIZE:] = 0
    noise[..., :PERSISTENT] = 0
    forecast = decode(s0, baseline[:, :2], condition[:, :1], noise[:, :1])[:, 0]
    change = baseline[:, 1] - baseline[:, 0]
    mean, factor = decode.transition(s0, change, condition[:, 0], s0)
    assert factor.shape == (ROWS, NOISE - PERSISTENT, SIZE)
    output = mean + torch.einsum("bz,bzd->bd", noise[:, 0, PERSISTENT:], factor)
    torch.testing.assert_close(forecast, s0 + decode.delta_std * output + change)


def test_the_baseline_moves_the_state() -> None:
    """With an output of zero, ε stays constant: s_t − b_t = s_0 − b_0."""
    decode, (s0, baseline, condition, noise) = decoder(), inputs()
    set_output_to_zero(decode)
    forecasts = decode(s0, baseline, condition, noise)
    torch.testing.assert_close(forecasts, s0[:, None] + baseline[:, 1:] - baseline[:, :1])


def test_the_gradient_decays_by_a_factor_at_every_step() -> None:
    decode, (s0, baseline, condition, noise) = decoder(), inputs()
    set_output_to_zero(decode)
    s0.requires_grad_()
    last = decode(s0, baseline, condition, noise)[:, -1]
    (gradient,) = torch.autograd.grad(last.sum(), s0)
    torch.testing.assert_close(gradient, torch.full_like(s0, GRADIENT_DECAY**STEPS))


def test_forecasts_in_blocks_without_gradient_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("study.models.networks.transition.MAX_ROWS", ROWS - 1)
    decode, values = decoder(), inputs()
    expected = decode(*values)
    with torch.no_grad():
        torch.testing.assert_close(decode(*values), expected)


def test_features_of_an_angle_are_periodic() -> None:
    """A full rotation changes the angle and no other feature."""
    decode, (s0, *_) = decoder(rotating=True), inputs()
    features = decode.features(s0)
    assert features.shape == (ROWS, SIZE + 4)
    rotated = s0.clone()
    rotated[:, 2] += 2 * torch.pi / decode.angle_scale
    torch.testing.assert_close(
        decode.features(rotated)[:, SIZE:], features[:, SIZE:], atol=1e-4, rtol=0
    )
    angle = s0[:, 2] * decode.angle_scale + decode.angle_mean
    expected = torch.stack([angle.sin(), angle.cos(), (2 * angle).sin(), (2 * angle).cos()], 1)
    torch.testing.assert_close(features[:, SIZE:], expected, atol=1e-4, rtol=0)


def test_forecasts_keep_to_the_range_of_the_training_states() -> None:
    decode, (s0, baseline, condition, noise) = decoder(), inputs()
    unlimited = decode(s0, 10 * baseline, condition, noise)
    states = torch.rand(20, STEPS, SIZE) - 0.5
    lowest, highest = states.amin((0, 1)), states.amax((0, 1))
    margin = RANGE_MARGIN * (highest - lowest)
    assert bool((unlimited > highest + margin).any())
    assert bool((unlimited < lowest - margin).any())
    decode.set_range(states)
    limited = decode(s0, 10 * baseline, condition, noise)
    torch.testing.assert_close(limited.amax((0, 1)), highest + margin)
    torch.testing.assert_close(limited.amin((0, 1)), lowest - margin)
    # The range is saved with the weights.
    loaded = decoder()
    loaded.load_state_dict(decode.state_dict())
    assert torch.equal(loaded(s0, 10 * baseline, condition, noise), limited)


def test_the_persistent_noise_has_no_effect_before_training() -> None:
    decode, (s0, baseline, condition, noise) = untrained_decoder(), inputs()
    expected = decode(s0, baseline, condition, noise)
    noise[..., :PERSISTENT] += 1.0
    assert torch.equal(decode(s0, baseline, condition, noise), expected)
    noise[..., PERSISTENT:] += 1.0
    assert not torch.equal(decode(s0, baseline, condition, noise), expected)
