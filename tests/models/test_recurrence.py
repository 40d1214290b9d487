"""The recurrent unit, and its derivative by hand."""

from typing import Any

import pytest
import torch
from torch import Tensor

from study.models.recurrence import feedback_gru, gru

BATCH, HIDDEN, STATE, STEPS = 2, 2, 3, 3


def arguments(*members: int) -> list[Tensor]:
    torch.manual_seed(0)
    shapes: list[tuple[int, ...]] = [
        (STEPS, *members, BATCH, 3 * HIDDEN),
        (STEPS, *members, BATCH, STATE),
        (*members, BATCH, HIDDEN),
        (*members, BATCH, STATE),
        (*members, HIDDEN, 3 * HIDDEN),
        (*members, 1, 3 * HIDDEN),
        (*members, STATE, 3 * HIDDEN),
        (*members, HIDDEN, STATE),
    ]
    return [torch.randn(shape, dtype=torch.float64, requires_grad=True) for shape in shapes]


def step_by_step(
    driven: Tensor,
    drift: Tensor,
    h: Tensor,
    s: Tensor,
    weight: Tensor,
    bias: Tensor,
    feed: Tensor,
    out: Tensor,
    keep: float,
) -> tuple[Tensor, Tensor]:
    """The equations in the docstring of `feedback_gru`, as they stand there."""
    hiddens, states = [], []
    for x, d in zip(driven + 0, drift, strict=True):
        (xr, xu, xn), (gr, gu, gn) = (
            (x + s @ feed).chunk(3, -1),
            (h @ weight + bias).chunk(3, -1),
        )
        r, u = torch.sigmoid(xr + gr), torch.sigmoid(xu + gu)
        h = (1 - u) * torch.tanh(xn + r * gn) + u * h
        s = keep * s + h @ out + d
        hiddens.append(h)
        states.append(s)
    return torch.stack(hiddens), torch.stack(states)


@pytest.mark.parametrize("keep", [0.0, 1.0])
@pytest.mark.parametrize("members", [(), (2,)])
def test_the_equations(members: tuple[int, ...], keep: float) -> None:
    given: list[Any] = [*arguments(*members), keep]
    for found, expected in zip(feedback_gru(*given), step_by_step(*given), strict=True):
        torch.testing.assert_close(found, expected)


@pytest.mark.parametrize("keep", [0.0, 1.0])
@pytest.mark.parametrize("members", [(), (2,)])
def test_the_derivative(members: tuple[int, ...], keep: float) -> None:
    given: list[Any] = [*arguments(*members), keep]
    assert torch.autograd.gradcheck(feedback_gru, given)


def test_without_gradient_the_numbers_are_the_same() -> None:
    given: list[Any] = [*arguments(), 1.0]
    with torch.no_grad():
        quick = feedback_gru(*given)
    torch.testing.assert_close(quick, feedback_gru(*given))


def test_without_a_state_it_is_the_gru_of_torch() -> None:
    torch.manual_seed(0)
    reference: Any = torch.nn.GRU(4, 3)
    inputs, hidden = torch.randn(7, 2, 4), torch.randn(2, 3)
    expected, _ = reference(inputs, hidden[None])
    driven = inputs @ reference.weight_ih_l0.T + reference.bias_ih_l0
    states = gru(driven, hidden, reference.weight_hh_l0.T, reference.bias_hh_l0)
    torch.testing.assert_close(states, expected)
