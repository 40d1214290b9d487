"""A feedforward network that feeds its own output back, over a whole sequence at once.

Derived by hand: the weights' derivatives are one product over all steps and rows. It is no faster
than automatic differentiation of the steps (tests/benchmarks/README.md).
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor


class Weights(NamedTuple):
    """Of one step; W is the width, L the number of hidden layers, Q = D + 2W."""

    feed: Tensor
    """[D, Q], what the state adds to the first layer."""
    layers: Tensor
    """[L, W, W]"""
    biases: Tensor
    """[L, W]"""
    out: Tensor
    """[W, D]"""


class Bounds(NamedTuple):
    """Where states are kept, [D] each."""

    lowest: Tensor
    highest: Tensor


def rollout(
    state: Tensor, driven: Tensor, drift: Tensor, weights: Weights, scale: Tensor, bounds: Bounds
) -> Tensor:
    """s_1 … s_T of a network that gives the change of the state.

        [l, u, v] = s_t feed + driven_t
        h_0 = u · silu(v),   h_i = h_{i−1} + silu(h_{i−1} layers_i + biases_i)
        s_{t+1} = min(max(s_t + scale · (l + h_L out) + drift_t, lowest), highest)

    The product of two linear maps (Shazeer, arXiv:2002.05202) makes distances, and velocities of
    points on turning bodies, from their coordinates in one layer.

    Args:
        state: s_0 [B, D].
        driven: what else the first layer sees, already multiplied, [B, T, Q].
        drift: [B, T, D].
        weights: see `Weights`.
        scale: [D].
        bounds: see `Bounds`.

    Returns:
        [B, T, D]
    """
    # Step by step is how the sequence is read and written.
    steps = (each.transpose(0, 1).contiguous() for each in (driven, drift))
    # Within `apply` it cannot be told whether a derivative is wanted.
    given = (state, *steps, *weights, scale, *bounds, torch.is_grad_enabled())
    return _Rollout.apply(*given).transpose(0, 1)


class _Rollout(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *given: Any) -> Tensor:
        *tensors, wanted = given
        state, driven, drift, feed, layers, biases, out, scale, lowest, highest = tensors
        derive = wanted and any(ctx.needs_input_grad)
        steps, rows, _ = driven.shape
        depth, width, _ = layers.shape
        size = state.shape[-1]
        kept = steps if derive else 1
        states = state.new_empty(steps + 1, rows, size)
        states[0] = state
        first = driven.new_empty(kept, rows, driven.shape[-1])
        sums = driven.new_empty(kept, depth, rows, width)
        hiddens = driven.new_empty(kept, depth + 1, rows, width)
        scaled = out * scale
        for t in range(steps):
            now = t if derive else 0
            torch.addmm(driven[t], states[t], feed, out=first[now])
            linear, u, v = first[now].split([size, width, width], -1)
            torch.mul(u, torch.nn.functional.silu(v), out=hiddens[now, 0])
            for i in range(depth):
                hidden = hiddens[now, i]
                torch.addmm(biases[i], hidden, layers[i], out=sums[now, i])
                added = torch.nn.functional.silu(sums[now, i])
                torch.add(hidden, added, out=hiddens[now, i + 1])
            change = torch.addmm(drift[t], hiddens[now, depth], scaled).addcmul_(linear, scale)
            torch.clamp(change.add_(states[t]), lowest, highest, out=states[t + 1])
        if derive:
            ctx.save_for_backward(*tensors[3:], states, first, sums, hiddens)
        return states[1:]

    @staticmethod
    def backward(ctx: Any, *given: Tensor) -> tuple[Tensor | None, ...]:
        (of_states,) = given
        feed, layers, _, out, scale, lowest, highest, *kept = ctx.saved_tensors
        states, first, sums, hiddens = kept
        steps, depth, _, width = sums.shape
        size = states.shape[-1]
        free = (states[1:] > lowest) & (states[1:] < highest)
        u, v = first[..., size : size + width], first[..., size + width :]
        by_u, by_v, slopes = torch.nn.functional.silu(v), u * _slope(v), _slope(sums)
        of_first, of_sums = torch.empty_like(first), torch.empty_like(sums)
        of_drift = torch.empty_like(states[1:])
        back, back_out, back_layers = feed.T, (out * scale).T, layers.mT
        of_state = torch.zeros_like(states[0])
        for t in reversed(range(steps)):
            torch.add(of_state, of_states[t], out=of_drift[t])
            of_next = of_drift[t].mul_(free[t])
            of_hidden = of_next @ back_out
            for i in reversed(range(depth)):
                torch.mul(of_hidden, slopes[t, i], out=of_sums[t, i])
                of_hidden.addmm_(of_sums[t, i], back_layers[i])
            of_linear, of_u, of_v = of_first[t].split([size, width, width], -1)
            torch.mul(of_next, scale, out=of_linear)
            torch.mul(of_hidden, by_u[t], out=of_u)
            torch.mul(of_hidden, by_v[t], out=of_v)
            of_state = torch.addmm(of_next, of_first[t], back)
        # All steps of all rows at once.
        of_feed = states[:-1].flatten(0, 1).T @ of_first.flatten(0, 1)
        seen, got = (x.transpose(0, 1).flatten(1, 2) for x in (hiddens, of_sums))
        of_out = (seen[-1].T @ of_drift.flatten(0, 1)) * scale
        of_layers, of_biases = seen[:-1].mT @ got, got.sum(1)
        weights = (of_feed, of_layers, of_biases, of_out)
        return of_state, of_first, of_drift, *weights, None, None, None, None


def _slope(x: Tensor) -> Tensor:
    """The derivative of silu(x) = x σ(x)."""
    sigmoid = torch.sigmoid(x)
    return sigmoid * (1 + x * (1 - sigmoid))
