"""The decoder whose next state comes from this one alone."""

import torch

from study.models.transition import TransitionDecoder

ROWS, STEPS, SIZE, CONDITION, NOISE = 4, 9, 3, 2, 5


def decoder() -> TransitionDecoder:
    torch.manual_seed(0)
    made = TransitionDecoder(torch.tensor([0.1, 0.2, 0.3]), CONDITION, 16, NOISE, lasting=2)
    torch.nn.init.normal_(made.linear.weight, std=0.1)
    return made


def given() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    return (
        torch.randn(ROWS, SIZE),
        torch.randn(ROWS, STEPS + 1, SIZE),
        torch.randn(ROWS, STEPS, CONDITION),
        torch.randn(ROWS, STEPS, NOISE),
    )


def test_a_state_is_all_that_the_future_needs_of_the_past() -> None:
    """Begun again in the middle, a forecast goes on as it would have."""
    decode, (s0, baseline, condition, noise) = decoder(), given()
    whole = decode(s0, baseline, condition, noise)
    half = 4
    rest = decode(whole[:, half - 1], baseline[:, half:], condition[:, half:], noise[:, half:])
    torch.testing.assert_close(rest, whole[:, half:])


def test_the_baseline_moves_the_state() -> None:
    """With a network that gives no change, ε stays what it is: s_t − b_t = s_0 − b_0."""
    decode, (s0, baseline, condition, noise) = decoder(), given()
    for parameter in (decode.linear.weight, decode.linear.bias, decode.out.weight):
        torch.nn.init.zeros_(parameter)
    forecasts = decode(s0, baseline, condition, noise)
    torch.testing.assert_close(forecasts, s0[:, None] + baseline[:, 1:] - baseline[:, :1])


def test_forecasts_keep_to_the_range_of_the_training_states() -> None:
    decode, (s0, baseline, condition, noise) = decoder(), given()
    free = decode(s0, 10 * baseline, condition, noise)
    states = torch.rand(20, STEPS, SIZE) - 0.5
    lowest, highest = states.amin((0, 1)), states.amax((0, 1))
    margin = 0.03 * (highest - lowest)
    assert bool((free > highest + margin).any())
    assert bool((free < lowest - margin).any())
    decode.bound(states)
    kept = decode(s0, 10 * baseline, condition, noise)
    assert bool((kept <= highest + margin).all())
    assert bool((kept >= lowest - margin).all())
    # The range is part of the weights' file.
    again = decoder()
    again.load_state_dict(decode.state_dict())
    assert torch.equal(again(s0, 10 * baseline, condition, noise), kept)


def test_the_lasting_noise_begins_without_effect() -> None:
    decode, (s0, baseline, condition, noise) = decoder(), given()
    torch.nn.init.zeros_(decode.linear.weight)
    expected = decode(s0, baseline, condition, noise)
    noise[..., :2] += 1.0
    assert torch.equal(decode(s0, baseline, condition, noise), expected)
    noise[..., 2:] += 1.0
    assert not torch.equal(decode(s0, baseline, condition, noise), expected)
