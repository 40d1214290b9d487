"""The rollout of a feedforward network: what it computes, and its derivative by hand."""

import pytest
import torch
from torch import Tensor

from study.models.rollout import Bounds, Weights, rollout

ROWS, STEPS, SIZE, WIDTH, LAYERS = 5, 7, 3, 4, 2


def given(bound: float) -> tuple[list[Tensor], Tensor, Bounds]:
    """State, driven, drift and the four weights, with derivatives wanted; scale and bounds."""
    draws = torch.Generator().manual_seed(0)

    def draw(*shape: int, scale: float = 0.5) -> Tensor:
        values = scale * torch.randn(*shape, generator=draws, dtype=torch.float64)
        return values.requires_grad_()

    width = SIZE + 2 * WIDTH
    values = [
        draw(ROWS, SIZE, scale=0.1),
        draw(ROWS, STEPS, width),
        draw(ROWS, STEPS, SIZE, scale=0.1),
        draw(SIZE, width),
        draw(LAYERS, WIDTH, WIDTH),
        draw(LAYERS, WIDTH),
        draw(WIDTH, SIZE),
    ]
    scale = torch.tensor([0.5, 1.0, 2.0], dtype=torch.float64)
    return values, scale, Bounds(torch.full_like(scale, -bound), torch.full_like(scale, bound))


def step(state: Tensor, driven: Tensor, drift: Tensor, weights: Weights, scale: Tensor) -> Tensor:
    """s_{t+1} before the bounds, as it is meant."""
    width = weights.out.shape[0]
    linear, u, v = (state @ weights.feed + driven).split([state.shape[-1], width, width], -1)
    hidden = u * torch.nn.functional.silu(v)
    for layer, bias in zip(weights.layers, weights.biases, strict=True):
        hidden = hidden + torch.nn.functional.silu(hidden @ layer + bias)
    return state + scale * (linear + hidden @ weights.out) + drift


def plain(values: list[Tensor], scale: Tensor, bounds: Bounds) -> Tensor:
    state, driven, drift, *weights = values
    states = []
    for now, added in zip(driven.unbind(1), drift.unbind(1), strict=True):
        state = torch.clamp(step(state, now, added, Weights(*weights), scale), *bounds)
        states.append(state)
    return torch.stack(states, dim=1)


def ours(values: list[Tensor], scale: Tensor, bounds: Bounds) -> Tensor:
    state, driven, drift, *weights = values
    return rollout(state, driven, drift, Weights(*weights), scale, bounds)


@pytest.mark.parametrize("bound", [torch.inf, 1.0])
def test_values_and_derivatives_are_those_of_the_steps(bound: float) -> None:
    values, scale, bounds = given(bound)
    expected, found = plain(values, scale, bounds), ours(values, scale, bounds)
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-12)
    limited = (expected.abs() == bound).double().mean()
    assert (0.05 < limited < 0.95) if bound < torch.inf else limited == 0
    asked = torch.randn(expected.shape, dtype=torch.float64)
    derivatives = torch.autograd.grad((found * asked).sum(), values)
    for by_hand, automatic in zip(
        derivatives, torch.autograd.grad((expected * asked).sum(), values), strict=True
    ):
        torch.testing.assert_close(by_hand, automatic, rtol=1e-9, atol=1e-12)


def test_without_a_derivative_the_values_are_the_same() -> None:
    values, scale, bounds = given(1.0)
    with torch.no_grad():
        found = ours(values, scale, bounds)
    assert found.grad_fn is None
    assert torch.equal(found, ours(values, scale, bounds))
