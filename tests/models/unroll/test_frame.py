"""The canonical frame turns with the state."""

import torch

from study.models.unroll.frame import SMALLEST_DISTANCE, direction, turn

PAIRS, AXIS = torch.tensor([[0, 3], [4, 2]]), torch.tensor([[0, 3], [4, 2]])
SCALE = torch.tensor([0.5, 2.0])
"""Two points, in units of 0.5 and of 2."""


def states() -> torch.Tensor:
    return torch.randn(7, 5, 6, generator=torch.Generator().manual_seed(0))


def test_the_axis_points_from_one_point_to_the_other() -> None:
    values = states()
    cos, sin = direction(values, AXIS, SCALE)
    start, end = 0.5 * values[..., [0, 3]], 2.0 * values[..., [4, 2]]
    expected = torch.atan2(*(end - start).flip(-1).unbind(-1))
    torch.testing.assert_close(cos[..., 0], expected.cos())
    torch.testing.assert_close(sin[..., 0], expected.sin())


def test_a_turn() -> None:
    values, angle = states(), torch.tensor([[[0.3]]])
    turned = turn(values, PAIRS, angle.cos(), angle.sin())
    for first, second in PAIRS.tolist():
        expected = torch.complex(values[..., first], values[..., second]) * torch.exp(1j * angle[0])
        torch.testing.assert_close(torch.complex(turned[..., first], turned[..., second]), expected)
    assert torch.equal(turned[..., [1, 5]], values[..., [1, 5]])


def test_a_turned_state_is_the_same_in_its_frame() -> None:
    values, angle = states(), torch.tensor([[[2.1]]])
    turned = turn(values, PAIRS, angle.cos(), angle.sin())
    both = []
    for state in (values, turned):
        cos, sin = direction(state, AXIS, SCALE)
        both.append(turn(state, PAIRS, cos, -sin))
    torch.testing.assert_close(both[1], both[0])


def test_two_points_at_the_same_place_have_a_finite_gradient() -> None:
    state = torch.zeros(6, requires_grad=True)
    cos, sin = direction(state, AXIS, SCALE)
    (cos + sin).sum().backward()
    assert state.grad is not None
    assert state.grad.isfinite().all()
    assert state.grad.abs().max() <= 2.0 / SMALLEST_DISTANCE
