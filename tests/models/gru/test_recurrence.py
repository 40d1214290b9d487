"""The recurrent unit: the torch version against its equations, the compiled one against torch."""

import os
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from study.models.gru import kernel
from study.models.gru.recurrence import feedback_gru, gru, torch_gru

# B, T, C, D, H that fill a block, a tile and a register exactly, and that fill none of them.
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
        # A sum over the hidden units is of order one, so that gates do not saturate.
        (torch.randn(shape, generator=generator, dtype=torch.float64) * hidden**-0.5)
        .to(dtype)
        .requires_grad_()
        for shape in shapes
    ]


def gradients(result: Tensor, arguments: list[Any]) -> tuple[Tensor, ...]:
    """Of a sum in which every number of the result has its own weight."""
    total = (result.double() * torch.arange(result.numel()).view_as(result).sin()).sum()
    return torch.autograd.grad(total, arguments)


def assert_close(found: tuple[Tensor, ...], expected: tuple[Tensor, ...]) -> None:
    for ours, theirs in zip(found, expected, strict=True):
        torch.testing.assert_close(ours.double(), theirs, rtol=1e-4, atol=1e-4)


@pytest.fixture
def compiled() -> None:
    kernel.library.cache_clear()
    if kernel.library() is None:
        pytest.fail("no C compiler") if os.environ.get("CI") else pytest.skip("no C compiler")


@pytest.mark.parametrize("residual", [0.0, 1.0])
@pytest.mark.parametrize("members", [(), (2,)])
def test_the_equations(members: tuple[int, ...], residual: float) -> None:
    values = arguments(members, (2, 3, 2, 3, 2), torch.float64)
    inputs, offset, h, s, weight_ih, weight_hh, bias, weight_ho = values
    hiddens, states = torch_gru(*[*values, residual])
    for t in range(3):
        x = torch.cat([inputs[..., t, :], s], -1) @ weight_ih + bias[..., :1, :]
        g = h @ weight_hh + bias[..., 1:, :]
        (x_r, x_u, x_n), (g_r, g_u, g_n) = x.chunk(3, -1), g.chunk(3, -1)
        r, u = torch.sigmoid(x_r + g_r), torch.sigmoid(x_u + g_u)
        h = (1 - u) * torch.tanh(x_n + r * g_n) + u * h
        s = residual * s + h @ weight_ho + offset[..., t, :]
        torch.testing.assert_close(hiddens[..., t, :], h)
        torch.testing.assert_close(states[..., t, :], s)


@pytest.mark.parametrize("residual", [0.0, 1.0])
@pytest.mark.parametrize("members", [(), (3,)])
@pytest.mark.parametrize("sizes", SIZES)
def test_the_kernel_computes_the_same(
    sizes: tuple[int, int, int, int, int], members: tuple[int, ...], residual: float, compiled: None
) -> None:
    """Values and gradients, against float64."""
    exact, values = (arguments(members, sizes, kind) for kind in (torch.float64, torch.float32))
    # A loss may depend on hidden states and on states.
    expected, found = (
        torch.cat(torch_gru(*[*exact, residual]), -1),
        torch.cat(feedback_gru(*[*values, residual]), -1),
    )
    torch.testing.assert_close(found.double(), expected, rtol=1e-5, atol=1e-5)
    assert_close(gradients(found, values), gradients(expected, exact))
    states = feedback_gru(*[*values, residual])[1]
    assert "Compiled" in str(states.grad_fn)
    assert_close(gradients(states, values), gradients(torch_gru(*[*exact, residual])[1], exact))


@pytest.mark.parametrize("members", [(), (3,)])
@pytest.mark.parametrize("sizes", SIZES)
def test_the_kernel_computes_the_same_without_a_state(
    sizes: tuple[int, int, int, int, int], members: tuple[int, ...], compiled: None
) -> None:
    batch, steps, inputs, _, hidden = sizes
    stateless = (batch, steps, inputs, 0, hidden)
    exact, values = (arguments(members, stateless, kind) for kind in (torch.float64, torch.float32))
    used = [values[i] for i in (0, 2, 4, 5, 6)]
    expected, found = torch_gru(*[*exact, 0.0])[0], gru(*used)
    assert "Compiled" in str(found.grad_fn)
    torch.testing.assert_close(found.double(), expected, rtol=1e-5, atol=1e-5)
    assert_close(gradients(found, used), gradients(expected, [exact[i] for i in (0, 2, 4, 5, 6)]))


@pytest.mark.parametrize("residual", [0.0, 1.0])
@pytest.mark.parametrize("members", [(), (3,)])
@pytest.mark.parametrize("sizes", SIZES)
def test_the_kernel_adds_the_same_noise(
    sizes: tuple[int, int, int, int, int], members: tuple[int, ...], residual: float, compiled: None
) -> None:
    """Its standard deviation depends on the hidden state, and it is fed back."""
    batch, steps, _, state, hidden = sizes
    exact = [value.detach() for value in arguments(members, sizes, torch.float64)]
    log_std_weight = torch.randn(*members, hidden + 1, state, dtype=torch.float64)
    noise = torch.randn(*members, batch, steps, state, dtype=torch.float64)
    values = [value.float() for value in exact]
    _, expected = torch_gru(*[*exact, residual, log_std_weight, noise])
    _, found = feedback_gru(*[*values, residual, log_std_weight.float(), noise.float()])
    torch.testing.assert_close(found.double(), expected, rtol=1e-4, atol=1e-4)
    hiddens, without = (result[..., 0, :] for result in torch_gru(*[*exact, residual]))
    log_std = torch.tanh(hiddens @ log_std_weight[..., :-1, :] + log_std_weight[..., -1:, :])
    torch.testing.assert_close(expected[..., 0, :], without + log_std.exp() * noise[..., 0, :])


def test_a_trajectory_does_not_depend_on_the_rest_of_the_batch(compiled: None) -> None:
    values = arguments((), (29, 6, 2, 3, 20), torch.float32)
    expected = feedback_gru(*[*values, 1.0])[1]
    for part in (slice(0, 1), slice(7, 20), slice(28, 29)):
        part_values = [value[part] for value in values[:4]] + values[4:]
        assert torch.equal(feedback_gru(*[*part_values, 1.0])[1], expected[part])


def test_neither_gradients_nor_threads_change_the_numbers(compiled: None) -> None:
    values: list[Any] = [*arguments((3,), (29, 6, 2, 3, 20), torch.float32), 1.0]
    expected = feedback_gru(*values)[1]
    with torch.no_grad():
        without_gradient = feedback_gru(*values)[1]
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(3)
        with_threads = feedback_gru(*values)[1]
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(without_gradient, expected)
    assert torch.equal(with_threads, expected)
    assert not without_gradient.requires_grad


def test_hidden_states_are_returned_on_request(compiled: None) -> None:
    values: list[Any] = [*arguments((2,), (5, 4, 2, 3, 8), torch.float32), 1.0]
    expected, _ = feedback_gru(*values)
    with torch.no_grad():
        found, _ = feedback_gru(*[*values, None, None, True])
        assert feedback_gru(*values)[0].numel() == 0
    assert torch.equal(found, expected)


def test_without_a_state_it_is_torch_nn_gru() -> None:
    torch.manual_seed(0)
    reference: Any = torch.nn.GRU(4, 3, batch_first=True)
    inputs, hidden = torch.randn(2, 7, 4), torch.randn(2, 3)
    expected, _ = reference(inputs, hidden[None])
    bias = torch.stack([reference.bias_ih_l0, reference.bias_hh_l0])
    states = gru(inputs, hidden, reference.weight_ih_l0.T, reference.weight_hh_l0.T, bias)
    torch.testing.assert_close(states, expected)


def test_saturated_gates_and_nan(compiled: None) -> None:
    values = [value.detach() for value in arguments((), (3, 4, 2, 3, 9), torch.float32)]
    values[0][0] *= 1e4
    values[0][1] = torch.nan
    ours, theirs = feedback_gru(*[*values, 1.0])[1], torch_gru(*[*values, 1.0])[1]
    torch.testing.assert_close(ours, theirs, equal_nan=True, rtol=1e-5, atol=1e-5)
    assert ours[1].isnan().all()
    assert ours[::2].isfinite().all()


@pytest.mark.parametrize("reason", ["switched off", "no compiler", "a compiler that fails"])
def test_without_a_library_torch_computes_it(
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
    kernel.library.cache_clear()
    try:
        assert kernel.library() is None
        values: list[Any] = [*arguments((), (2, 3, 2, 3, 4), torch.float32), 1.0]
        assert torch.equal(feedback_gru(*values)[1], torch_gru(*values)[1])
    finally:
        kernel.library.cache_clear()
