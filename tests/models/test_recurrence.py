"""The hand-written derivative of the GRU."""

import pytest
import torch

from study.models.recurrence import gru, gru_cell


def arguments(*members: int) -> tuple[torch.Tensor, ...]:
    torch.manual_seed(0)
    shapes = [(3, *members, 2, 6), (*members, 2, 2), (*members, 2, 6), (*members, 1, 6)]
    return tuple(torch.randn(s, dtype=torch.float64, requires_grad=True) for s in shapes)


@pytest.mark.parametrize("members", [(), (2,)])
def test_the_sequence_is_the_cell_step_by_step(members: tuple[int, ...]) -> None:
    driven, hidden, weight, bias = arguments(*members)
    states = gru(driven, hidden, weight, bias)
    for step, inputs in enumerate(driven.unbind(0)):
        hidden = gru_cell(inputs, hidden @ weight + bias, hidden)
        torch.testing.assert_close(states[step], hidden)


@pytest.mark.parametrize("members", [(), (2,)])
def test_the_derivative(members: tuple[int, ...]) -> None:
    assert torch.autograd.gradcheck(gru, arguments(*members))


def test_it_is_the_gru_of_torch() -> None:
    torch.manual_seed(0)
    reference = torch.nn.GRU(4, 3)
    inputs, hidden = torch.randn(7, 2, 4), torch.randn(2, 3)
    expected, _ = reference(inputs, hidden[None])
    driven = inputs @ reference.weight_ih_l0.T + reference.bias_ih_l0
    states = gru(driven, hidden, reference.weight_hh_l0.T, reference.bias_hh_l0)
    torch.testing.assert_close(states, expected)


def test_without_gradient_the_numbers_are_the_same() -> None:
    driven, hidden, weight, bias = arguments()
    with torch.no_grad():
        quick = gru(driven, hidden, weight, bias)
    torch.testing.assert_close(quick, gru(driven, hidden, weight, bias))
