"""The recurrent unit: in torch as its equations say, and compiled as in torch."""

import os
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from study.models.gru import native
from study.models.gru.recurrence import feedback_gru, gru, plain

# Sizes that fill a block, a tile and a register exactly, and sizes that leave rests of all three.
SIZES = [(12, 5, 3, 8, 16), (13, 4, 2, 3, 7), (1, 3, 0, 1, 1), (29, 2, 5, 17, 33)]


def arguments(
    members: tuple[int, ...], sizes: tuple[int, int, int, int, int], dtype: torch.dtype
) -> list[Any]:
    batch, steps, inputs, state, hidden = sizes
    generator = torch.Generator().manual_seed(0)
    shapes: list[tuple[int, ...]] = [
        (*members, batch, steps, inputs),
        (*members, batch, steps, state),
        (*members, batch, hidden),
        (*members, batch, state),
        (*members, inputs + state, 3 * hidden),
        (*members, hidden, 3 * hidden),
        (*members, 2, 3 * hidden),
        (*members, hidden, state),
    ]
    return [
        # Of order one after a sum over the hidden units, so that gates do not saturate.
        (torch.randn(shape, generator=generator, dtype=torch.float64) * hidden**-0.5)
        .to(dtype)
        .requires_grad_()
        for shape in shapes
    ]


def derivatives(result: Tensor, given: list[Any]) -> tuple[Tensor, ...]:
    """Of a sum in which every number of the result has another weight."""
    total = (result.double() * torch.arange(result.numel()).view_as(result).sin()).sum()
    return torch.autograd.grad(total, given)


def same(found: tuple[Tensor, ...], expected: tuple[Tensor, ...]) -> None:
    for ours, theirs in zip(found, expected, strict=True):
        torch.testing.assert_close(ours.double(), theirs, rtol=1e-4, atol=1e-4)


@pytest.fixture
def compiled() -> None:
    native.library.cache_clear()
    if native.library() is None:
        pytest.fail("no C compiler") if os.environ.get("CI") else pytest.skip("no C compiler")


@pytest.mark.parametrize("keep", [0.0, 1.0])
@pytest.mark.parametrize("members", [(), (2,)])
def test_the_equations(members: tuple[int, ...], keep: float) -> None:
    given = arguments(members, (2, 3, 2, 3, 2), torch.float64)
    inputs, drift, h, s, enter, weight, bias, out = given
    hiddens, states = plain(*[*given, keep])
    for t in range(3):
        x = torch.cat([inputs[..., t, :], s], -1) @ enter + bias[..., :1, :]
        g = h @ weight + bias[..., 1:, :]
        (x_r, x_u, x_n), (g_r, g_u, g_n) = x.chunk(3, -1), g.chunk(3, -1)
        r, u = torch.sigmoid(x_r + g_r), torch.sigmoid(x_u + g_u)
        h = (1 - u) * torch.tanh(x_n + r * g_n) + u * h
        s = keep * s + h @ out + drift[..., t, :]
        torch.testing.assert_close(hiddens[..., t, :], h)
        torch.testing.assert_close(states[..., t, :], s)


@pytest.mark.parametrize("keep", [0.0, 1.0])
@pytest.mark.parametrize("members", [(), (3,)])
@pytest.mark.parametrize("sizes", SIZES)
def test_compiled_it_is_the_same(
    sizes: tuple[int, int, int, int, int], members: tuple[int, ...], keep: float, compiled: None
) -> None:
    """Forwards and backwards, against float64."""
    exact, given = (arguments(members, sizes, kind) for kind in (torch.float64, torch.float32))
    # Hidden states and states side by side: a loss may be of both.
    expected, found = (
        torch.cat(plain(*[*exact, keep]), -1),
        torch.cat(feedback_gru(*[*given, keep]), -1),
    )
    torch.testing.assert_close(found.double(), expected, rtol=1e-5, atol=1e-5)
    same(derivatives(found, given), derivatives(expected, exact))
    states = feedback_gru(*[*given, keep])[1]
    assert "Compiled" in str(states.grad_fn)
    same(derivatives(states, given), derivatives(plain(*[*exact, keep])[1], exact))


@pytest.mark.parametrize("members", [(), (3,)])
@pytest.mark.parametrize("sizes", SIZES)
def test_compiled_it_is_the_same_without_a_state(
    sizes: tuple[int, int, int, int, int], members: tuple[int, ...], compiled: None
) -> None:
    batch, steps, inputs, _, hidden = sizes
    none = (batch, steps, inputs, 0, hidden)
    exact, given = (arguments(members, none, kind) for kind in (torch.float64, torch.float32))
    own = [given[i] for i in (0, 2, 4, 5, 6)]
    expected, found = plain(*[*exact, 0.0])[0], gru(*own)
    assert "Compiled" in str(found.grad_fn)
    torch.testing.assert_close(found.double(), expected, rtol=1e-5, atol=1e-5)
    same(derivatives(found, own), derivatives(expected, [exact[i] for i in (0, 2, 4, 5, 6)]))


@pytest.mark.parametrize("keep", [0.0, 1.0])
@pytest.mark.parametrize("members", [(), (3,)])
@pytest.mark.parametrize("sizes", SIZES)
def test_compiled_its_noise_is_the_same(
    sizes: tuple[int, int, int, int, int], members: tuple[int, ...], keep: float, compiled: None
) -> None:
    """As wide as the hidden state says, and fed back."""
    batch, steps, _, state, hidden = sizes
    exact = [each.detach() for each in arguments(members, sizes, torch.float64)]
    spread = torch.randn(*members, hidden + 1, state, dtype=torch.float64)
    noise = torch.randn(*members, batch, steps, state, dtype=torch.float64)
    given = [each.float() for each in exact]
    _, expected = plain(*[*exact, keep, spread, noise])
    _, found = feedback_gru(*[*given, keep, spread.float(), noise.float()])
    torch.testing.assert_close(found.double(), expected, rtol=1e-4, atol=1e-4)
    hiddens, without = (each[..., 0, :] for each in plain(*[*exact, keep]))
    width = torch.tanh(hiddens @ spread[..., :-1, :] + spread[..., -1:, :]).exp()
    torch.testing.assert_close(expected[..., 0, :], without + width * noise[..., 0, :])


def test_a_trajectory_does_not_depend_on_those_beside_it(compiled: None) -> None:
    given = arguments((), (29, 6, 2, 3, 20), torch.float32)
    whole = feedback_gru(*[*given, 1.0])[1]
    for part in (slice(0, 1), slice(7, 20), slice(28, 29)):
        some = [each[part] for each in given[:4]] + given[4:]
        assert torch.equal(feedback_gru(*[*some, 1.0])[1], whole[part])


def test_neither_derivatives_nor_threads_change_the_numbers(compiled: None) -> None:
    given: list[Any] = [*arguments((3,), (29, 6, 2, 3, 20), torch.float32), 1.0]
    expected = feedback_gru(*given)[1]
    with torch.no_grad():
        quick = feedback_gru(*given)[1]
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(3)
        apart = feedback_gru(*given)[1]
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(quick, expected)
    assert torch.equal(apart, expected)
    assert not quick.requires_grad


def test_hidden_states_are_there_where_they_are_asked_for(compiled: None) -> None:
    given: list[Any] = [*arguments((2,), (5, 4, 2, 3, 8), torch.float32), 1.0]
    expected, _ = feedback_gru(*given)
    with torch.no_grad():
        found, _ = feedback_gru(*[*given, None, None, True])
        assert feedback_gru(*given)[0].numel() == 0
    assert torch.equal(found, expected)


def test_without_a_state_it_is_the_gru_of_torch() -> None:
    torch.manual_seed(0)
    reference: Any = torch.nn.GRU(4, 3, batch_first=True)
    inputs, hidden = torch.randn(2, 7, 4), torch.randn(2, 3)
    expected, _ = reference(inputs, hidden[None])
    bias = torch.stack([reference.bias_ih_l0, reference.bias_hh_l0])
    states = gru(inputs, hidden, reference.weight_ih_l0.T, reference.weight_hh_l0.T, bias)
    torch.testing.assert_close(states, expected)


def test_gates_that_saturate_and_numbers_that_are_none(compiled: None) -> None:
    given = [each.detach() for each in arguments((), (3, 4, 2, 3, 9), torch.float32)]
    given[0][0] *= 1e4
    given[0][1] = torch.nan
    ours, theirs = feedback_gru(*[*given, 1.0])[1], plain(*[*given, 1.0])[1]
    torch.testing.assert_close(ours, theirs, equal_nan=True, rtol=1e-5, atol=1e-5)
    assert ours[1].isnan().all()
    assert ours[::2].isfinite().all()


@pytest.mark.parametrize("reason", ["switched off", "no compiler", "a compiler that fails"])
def test_without_a_library_torch_does_it(
    reason: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    if reason == "switched off":
        monkeypatch.setenv("STUDY_COMPILED", "0")
    elif reason == "no compiler":
        monkeypatch.delenv("CC", raising=False)
        monkeypatch.setenv("PATH", str(tmp_path))
    else:
        broken = tmp_path / "broken"
        broken.write_text('#!/bin/sh\n[ "$1" = --version ] && exit 0\nexit 1\n')
        broken.chmod(0o755)
        monkeypatch.setenv("CC", str(broken))
    native.library.cache_clear()
    try:
        assert native.library() is None
        given: list[Any] = [*arguments((), (2, 3, 2, 3, 4), torch.float32), 1.0]
        assert torch.equal(feedback_gru(*given)[1], plain(*given)[1])
    finally:
        native.library.cache_clear()
