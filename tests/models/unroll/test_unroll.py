"""The unrolled network: the torch version against its equations, the compiled one against torch."""

import os
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from study.common.arrays import Doubles
from study.models.unroll import kernel
from study.models.unroll.gru import gru
from study.models.unroll.unroll import LOG_STD_BOUND, Weights, features
from tests.helpers.unrolled import Case, Sizes, bounded, case

DECAY = 0.8

BOTH, STEM = Sizes(2, 5, 4, 3, 1, 6, 6, 2), Sizes(2, 5, 4, 3, 1, 6, 0, 2)
STATELESS = [Sizes(2, 5, 4, 0, 0, 0, 7, 0), Sizes(1, 12, 3, 0, 0, 0, 32, 0)]
EXACT, INEXACT = Sizes(1, 12, 3, 32, 0, 32, 32, 2), Sizes(2, 13, 4, 3, 1, 7, 5, 1)
SIZES = [
    EXACT,  # fills blocks, tiles and registers
    INEXACT,  # fills none of them
    Sizes(2, 24, 2, 16, 2, 64, 48, 1),
    Sizes(1, 29, 3, 17, 2, 33, 32, 0),
    Sizes(3, 3, 3, 1, 1, 4, 0, 2),  # without memory
    Sizes(1, 5, 4, 4, 1, 9, 0, 0),
    Sizes(2, 7, 3, 2, 0, 1, 0, 0),  # a unit alone
    Sizes(2, 5, 4, 3, 0, 0, 7, 0),  # without a stem: a GRU
    Sizes(2, 14, 6, 5, 1, 0, 18, 2),
    Sizes(1, 13, 4, 7, 0, 9, 0, 2, pairs=3),  # in a canonical frame
    Sizes(2, 5, 3, 6, 1, 6, 5, 1, pairs=2),
]


def weighted_sum(*results: Tensor) -> Tensor:
    """A sum in which every number has its own weight."""
    return sum(
        ((x.double() * torch.arange(x.numel()).view_as(x).sin()).sum() for x in results),
        torch.zeros((), dtype=torch.float64),
    )


def gradients(total: Tensor, arguments: list[Tensor]) -> list[Tensor]:
    return list(torch.autograd.grad(total, arguments, allow_unused=True, materialize_grads=True))


def assert_close(found: Any, expected: Any, tolerance: float = 1e-4) -> None:
    """Values in float32 against float64, relative to the largest of an array."""
    for ours, exact in zip(found, expected, strict=True):
        largest = max(1.0, float(exact.detach().abs().max())) if exact.numel() else 1.0
        torch.testing.assert_close(ours.double(), exact, rtol=0, atol=tolerance * largest)


@pytest.fixture
def compiled() -> None:
    kernel.library.cache_clear()
    if kernel.library() is None:
        pytest.fail("no C compiler") if os.environ.get("CI") else pytest.skip("no C compiler")


def sigmoid(x: Doubles) -> Doubles:
    return np.asarray(1 / (1 + np.exp(-x)))


def silu(x: Doubles) -> Doubles:
    return np.asarray(x * sigmoid(x))


def trajectory(arguments: Case, sizes: Sizes, m: int, b: int) -> Iterator[tuple[Doubles, Doubles]]:
    """s_{t+1} and y of one trajectory, step by step: the equations of `unroll`."""
    weights: dict[str, Any] = {
        entry.name: value.numpy()
        for entry in fields(Weights)
        if (value := getattr(arguments.weights, entry.name)) is not None
    }
    shared = {entry.name for entry in fields(Weights)[12:]}
    w = {key: value if key in shared else value[m] for key, value in weights.items()}
    s, h = arguments.state[m, b].numpy(), arguments.hidden[m, b].numpy()
    for t in range(sizes.steps):
        previous, turned = s, np.eye(sizes.state)
        if sizes.pairs:
            start, end = s[w["axis_columns"]] * w["axis_scale"][:, None]
            cos, sin = (end - start) / np.linalg.norm(end - start)
            for x, y in w["pair_columns"]:
                turned[np.ix_([x, y], [x, y])] = [[cos, -sin], [sin, cos]]
            s = turned.T @ s
        angle = s[w["angle_columns"]] * w["angle_scale"] + w["angle_mean"]
        waves = [np.sin(angle), np.cos(angle), np.sin(2 * angle), np.cos(2 * angle)]
        sums = arguments.terms[m, b, t].numpy() + np.concatenate([s, *waves]) @ w["state"]
        d, p, memory = sizes.state, sizes.stem, sizes.memory
        skip, u, v, g = np.split(sums, [d, d + p, d + 2 * p])
        y = u * silu(v)
        if memory:
            x_n, x_r, x_u = np.split(g + y @ w["gates"], 3)
            h_r, h_u, h_n = np.split(h @ w["hidden"], 3)
            n = np.tanh(x_n + sigmoid(x_r + h_r) * (h_n + w["hidden_bias"]))
            h = (1 - sigmoid(x_u + h_u)) * n + sigmoid(x_u + h_u) * h
            mixed = np.concatenate([h, y])
            y = y + mixed @ w["mix"] + w["mix_bias"] if p else h
        for weight, bias in zip(w["layers"], w["layers_bias"], strict=True):
            y = y + silu(y @ weight + bias)
        s = skip + y @ w["output"]
        if arguments.gain is not None:
            s = s + (y * arguments.gain[m, b, t].numpy()) @ w["noise_output"]
        if arguments.noise is not None:
            log_std = y @ w["log_std"] + w["log_std_bias"]
            log_std = LOG_STD_BOUND * np.tanh(log_std / LOG_STD_BOUND)
            s = s + np.exp(log_std) * arguments.noise[m, b, t].numpy()
        if sizes.pairs:
            s = previous + turned @ s
        s = np.minimum(np.maximum(s, w["lowest"]), w["highest"])
        yield s, y


@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize("gain", [False, True])
@pytest.mark.parametrize(
    "sizes",
    [
        Sizes(2, 3, 4, 3, 2, 5, 5, 2),
        Sizes(2, 3, 4, 3, 1, 5, 4, 0),
        Sizes(2, 3, 4, 3, 1, 5, 0, 2),
        Sizes(2, 3, 4, 3, 0, 0, 5, 0),
        Sizes(2, 3, 4, 3, 1, 0, 5, 1),
        Sizes(2, 3, 4, 5, 0, 5, 0, 1, pairs=2),
    ],
)
def test_the_equations(sizes: Sizes, gain: bool, noise: bool) -> None:
    arguments = bounded(case(sizes, gain, noise))
    states, tops = arguments.torch_unroll()
    for m in range(sizes.networks):
        for b in range(sizes.batch):
            for t, (state, top) in enumerate(trajectory(arguments, sizes, m, b)):
                np.testing.assert_allclose(states[m, b, t], state, rtol=1e-9, atol=1e-9)
                np.testing.assert_allclose(tops[m, b, t], top, rtol=1e-9, atol=1e-9)


def test_features_of_an_angle() -> None:
    states = torch.randn(4, 5, 3).double()
    columns, mean, scale = torch.tensor([2, 0]), torch.randn(2).double(), torch.rand(2).double()
    psi = states[..., columns] * scale + mean
    expected = torch.cat([states, psi.sin(), psi.cos(), (2 * psi).sin(), (2 * psi).cos()], -1)
    torch.testing.assert_close(features(states, columns, mean, scale), expected)
    assert torch.equal(features(states, columns[:0], mean[:0], scale[:0]), states)


@pytest.mark.parametrize("decay", [DECAY, 1.0])
@pytest.mark.parametrize("version", [Case.unroll, Case.torch_unroll])
def test_the_gradient_decays_at_every_step(version: Any, decay: float) -> None:
    """Of a network whose state stays constant."""
    arguments = case(BOTH)
    identity = torch.zeros_like(arguments.weights.state)
    identity[:, : BOTH.state, : BOTH.state] = torch.eye(BOTH.state)
    weights = replace(
        arguments.weights, state=identity, output=torch.zeros_like(arguments.weights.output)
    )
    arguments = replace(arguments, weights=weights).to(torch.float32)
    arguments.state.requires_grad_()
    states, _ = version(arguments, decay)
    (gradient,) = torch.autograd.grad(states[:, :, -1].sum(), arguments.state)
    torch.testing.assert_close(gradient, torch.full_like(gradient, decay**BOTH.steps))


@pytest.mark.parametrize("decay", [DECAY, 1.0])
@pytest.mark.parametrize("has_bounds", [False, True])
@pytest.mark.parametrize("gain", [False, True])
@pytest.mark.parametrize("sizes", SIZES)
def test_the_kernel_computes_the_same(
    sizes: Sizes, gain: bool, has_bounds: bool, decay: float, compiled: None
) -> None:
    """Values and gradients, against float64."""
    exact = bounded(case(sizes, gain)) if has_bounds else case(sizes, gain)
    values = exact.to(torch.float32)
    of_exact, of_values = exact.differentiable(), values.differentiable()
    expected = exact.torch_unroll(decay)
    found = values.unroll(decay)
    assert "Compiled" in str(found[0].grad_fn)
    assert_close(found, expected, 1e-5)
    # A loss may depend on states, on tops or on both.
    for part in (slice(0, 1), slice(1, 2), slice(0, 2)):
        expected = exact.torch_unroll(decay)
        found = values.unroll(decay)
        assert_close(
            gradients(weighted_sum(*found[part]), of_values),
            gradients(weighted_sum(*expected[part]), of_exact),
        )


@pytest.mark.parametrize("has_bounds", [False, True])
@pytest.mark.parametrize("gain", [False, True])
@pytest.mark.parametrize("sizes", SIZES)
def test_the_kernel_adds_the_same_noise(
    sizes: Sizes, gain: bool, has_bounds: bool, compiled: None
) -> None:
    """Its standard deviation depends on the network, and it is fed back."""
    exact = case(sizes, gain, noise=True)
    if has_bounds:
        exact = bounded(exact)
    values = exact.to(torch.float32)
    with torch.no_grad():
        expected = exact.torch_unroll()
        found = values.unroll()
        without, _ = replace(exact, noise=None).torch_unroll()
    assert_close(found, expected)
    assert not torch.allclose(expected[0], without, atol=0.1)


@pytest.mark.parametrize("sizes", STATELESS)
def test_the_kernel_computes_the_same_without_a_state(sizes: Sizes, compiled: None) -> None:
    exact = case(sizes)
    values = exact.to(torch.float32)
    results = []
    for arguments, dtype in ((exact, torch.float64), (values, torch.float32)):
        assert arguments.terms.dtype == dtype
        weights = arguments.weights
        used = [arguments.terms, arguments.hidden, weights.hidden, weights.hidden_bias]
        hiddens = gru(*(value.requires_grad_() for value in used))
        results.append((hiddens, *gradients(weighted_sum(hiddens), used)))
    assert "Compiled" in str(results[1][0].grad_fn)
    assert "Compiled" not in str(results[0][0].grad_fn)
    assert_close(results[1], results[0])


@pytest.mark.parametrize("sizes", [replace(size, batch=29) for size in SIZES])
def test_a_trajectory_does_not_depend_on_the_rest_of_the_batch(
    sizes: Sizes, compiled: None
) -> None:
    arguments = case(sizes, gain=True).to(torch.float32)
    expected = torch.cat(arguments.unroll(), -1)
    for part in (slice(0, 1), slice(7, 20), slice(28, 29), slice(5, 5)):
        rows = arguments.rows(part)
        found = torch.cat(rows.unroll(), -1)
        assert torch.equal(found, expected[:, part])


def test_neither_gradients_nor_threads_change_the_numbers(compiled: None) -> None:
    arguments = case(replace(INEXACT, networks=3, batch=29), gain=True).to(torch.float32)
    inputs = arguments.differentiable()

    def results() -> list[Tensor]:
        found = arguments.unroll(DECAY)
        return [*found, *gradients(weighted_sum(*found), inputs)]

    expected = results()
    with torch.no_grad():
        without_gradient = arguments.unroll(DECAY)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(3)
        with_threads = results()
    finally:
        torch.set_num_threads(threads)
    for ours, theirs in zip(without_gradient, expected[:2], strict=True):
        assert torch.equal(ours, theirs)
        assert not ours.requires_grad
    for ours, theirs in zip(with_threads[:2], expected[:2], strict=True):
        assert torch.equal(ours, theirs)
    assert_close(with_threads[2:], [value.double() for value in expected[2:]], 1e-6)


def test_tops_are_returned_on_request(compiled: None) -> None:
    arguments = case(INEXACT).to(torch.float32)
    states, tops = arguments.unroll()
    assert tops.shape == (*states.shape[:3], INEXACT.width())
    without, none = arguments.unroll(return_tops=False)
    assert none.numel() == 0
    assert torch.equal(without, states)


def test_without_a_state_it_is_torch_nn_gru() -> None:
    torch.manual_seed(0)
    reference: Any = torch.nn.GRU(4, 3, batch_first=True)
    inputs, hidden = torch.randn(2, 7, 4), torch.randn(2, 3)
    expected, _ = reference(inputs, hidden[None])
    # torch's order of the gates is r, u (there z), n, and every gate has two biases.
    r, u, n = reference.weight_ih_l0.chunk(3)
    b_r, b_u, _ = (reference.bias_ih_l0 + reference.bias_hh_l0).chunk(3)
    b_n, hidden_bias = (bias.chunk(3)[2] for bias in (reference.bias_ih_l0, reference.bias_hh_l0))
    gates = inputs @ torch.cat([n, r, u]).T + torch.cat([b_n, b_r, b_u])
    weight = reference.weight_hh_l0.T
    found = gru(gates[None], hidden[None], weight[None], hidden_bias[None])[0]
    torch.testing.assert_close(found, expected)


@pytest.mark.parametrize("sizes", [BOTH, STEM, replace(BOTH, stem=0)])
def test_saturated_gates_and_nan(sizes: Sizes, compiled: None) -> None:
    arguments = bounded(case(sizes)).to(torch.float32)
    arguments.terms[:, 0] *= 1e4
    arguments.terms[:, 1] = torch.nan
    ours, theirs = (result[0] for result in (arguments.unroll(), arguments.torch_unroll()))
    torch.testing.assert_close(ours, theirs, equal_nan=True, rtol=1e-4, atol=1e-4)
    assert ours[:, 1].isnan().all()
    assert ours[:, 0].isfinite().all()
    assert ours[:, 2:].isfinite().all()


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
        arguments = case(BOTH, gain=True).to(torch.float32)
        for ours, theirs in zip(arguments.unroll(), arguments.torch_unroll(), strict=True):
            assert torch.equal(ours, theirs)
    finally:
        kernel.library.cache_clear()
