"""The decoder whose next state comes from this one."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from study.data.normalization import Normalization
from study.models.networks.transition import CREDIT, MARGIN, TransitionDecoder
from tests.helpers.models import trajectories

ROWS, STEPS, SIZE, CONDITION, NOISE, LASTING = 4, 9, 3, 2, 5, 2


def decoder(turned: bool = False) -> TransitionDecoder:
    """One that has learned something of everything it sees."""
    torch.manual_seed(0)
    pairs = np.array([[0, 1, 2]] if turned else []).reshape(-1, 3).astype(np.int64)
    scale = np.array([0.1, 0.2, 0.3], np.float32)
    normalization = replace(Normalization.of(trajectories()), rotating_pairs=pairs, delta_std=scale)
    made = TransitionDecoder(normalization, CONDITION, 16, NOISE, LASTING)
    torch.nn.init.normal_(made.linear.weight, std=0.1)
    torch.nn.init.normal_(made.first.weight, std=0.3)
    return made


def given() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    return (
        torch.randn(ROWS, SIZE),
        torch.randn(ROWS, STEPS + 1, SIZE),
        torch.randn(ROWS, STEPS, CONDITION),
        torch.randn(ROWS, STEPS, NOISE),
    )


def test_a_step_has_the_distribution_that_its_score_is_of() -> None:
    """Where u and v do not see s_0, and nothing lasts: the mean plus z times the factor."""
    for turned in (False, True):
        decode, (s0, baseline, condition, noise) = decoder(turned), given()
        decode.first.weight.data[:, -SIZE:] = 0
        noise[..., :LASTING] = 0
        forecast = decode(s0, baseline[:, :2], condition[:, :1], noise[:, :1])[:, 0]
        drift = baseline[:, 1] - baseline[:, 0]
        mean, factor = decode.transition(s0, drift, condition[:, 0], s0)
        assert factor.shape == (ROWS, NOISE - LASTING, SIZE)
        change = mean + torch.einsum("bz,bzd->bd", noise[:, 0, LASTING:], factor)
        torch.testing.assert_close(forecast, s0 + decode.delta_std * change + drift)


def test_the_baseline_moves_the_state() -> None:
    """With a network that gives no change, ε stays what it is: s_t − b_t = s_0 − b_0."""
    decode, (s0, baseline, condition, noise) = decoder(), given()
    nothing(decode)
    forecasts = decode(s0, baseline, condition, noise)
    torch.testing.assert_close(forecasts, s0[:, None] + baseline[:, 1:] - baseline[:, :1])


def nothing(decode: TransitionDecoder) -> None:
    """Make it give no change."""
    for parameter in (decode.linear.weight, decode.out.weight, decode.shift.weight):
        torch.nn.init.zeros_(parameter)


def test_credit_ends_after_some_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Values are the same with a derivative and without, which is in blocks; the one fades."""
    monkeypatch.setattr("study.models.networks.transition.ROWS", ROWS - 1)
    decode, (s0, baseline, condition, noise) = decoder(), given()
    s0.requires_grad_()
    forecasts = decode(s0, baseline, condition, noise)
    with torch.no_grad():
        torch.testing.assert_close(decode(s0, baseline, condition, noise), forecasts)
    nothing(decode)
    last = decode(s0, baseline, condition, noise)[:, -1]
    (derivative,) = torch.autograd.grad(last.sum(), s0)
    torch.testing.assert_close(derivative, torch.full_like(s0, CREDIT**STEPS))


def test_headings_come_round() -> None:
    """A full turn of the angle changes nothing but the angle itself."""
    decode, (s0, *_) = decoder(turned=True), given()
    seen = decode._seen(s0)
    assert seen.shape == (ROWS, SIZE + 4)
    around = s0.clone()
    around[:, 2] += 2 * torch.pi / decode.angle_scale
    torch.testing.assert_close(decode._seen(around)[:, SIZE:], seen[:, SIZE:], atol=1e-4, rtol=0)
    angle = (s0[:, 2] * decode.angle_scale + decode.angle_mean)[:, None] * torch.tensor([1.0, 2.0])
    expected = torch.stack([angle.sin(), angle.cos()], 1).flatten(1)[:, [0, 2, 1, 3]]
    torch.testing.assert_close(seen[:, SIZE:], expected, atol=1e-4, rtol=0)


def test_forecasts_keep_to_the_range_of_the_training_states() -> None:
    decode, (s0, baseline, condition, noise) = decoder(), given()
    free = decode(s0, 10 * baseline, condition, noise)
    states = torch.rand(20, STEPS, SIZE) - 0.5
    lowest, highest = states.amin((0, 1)), states.amax((0, 1))
    margin = MARGIN * (highest - lowest)
    assert bool((free > highest + margin).any())
    assert bool((free < lowest - margin).any())
    decode.bound(states)
    kept = decode(s0, 10 * baseline, condition, noise)
    torch.testing.assert_close(kept.amax((0, 1)), highest + margin)
    torch.testing.assert_close(kept.amin((0, 1)), lowest - margin)
    # The range is part of the weights' file.
    again = decoder()
    again.load_state_dict(decode.state_dict())
    assert torch.equal(again(s0, 10 * baseline, condition, noise), kept)


def test_the_lasting_noise_begins_without_effect() -> None:
    normalization = Normalization.of(trajectories())
    torch.manual_seed(0)
    decode, (s0, baseline, condition, noise) = (
        TransitionDecoder(normalization, 2, 16, NOISE, 2),
        given(),
    )
    expected = decode(s0, baseline, condition, noise)
    noise[..., :LASTING] += 1.0
    assert torch.equal(decode(s0, baseline, condition, noise), expected)
    noise[..., LASTING:] += 1.0
    assert not torch.equal(decode(s0, baseline, condition, noise), expected)
