"""The gated recurrent unit, taken apart for speed and for loops that must feed back.

On a CPU a network of this size spends its time not on arithmetic but on the bookkeeping of
thousands of small operations. `gru` does a whole sequence, forwards and backwards, by hand; `gru_cell`
does one step under autograd, where something must happen between two steps.

Both take what drives the unit already multiplied, for the whole horizon at once.
"""

from typing import Any

import torch
from torch import Tensor


def gru_cell(driven: Tensor, recurrent: Tensor, hidden: Tensor) -> Tensor:
    """h_{t+1} of a GRU (Cho et al. 2014, in the form of `torch.nn.GRU`).

        r, u = σ(driven + recurrent),  n = tanh(driven + r · recurrent),  h' = (1 − u) n + u h

    Args:
        driven: what drives the gates r, u and the candidate n, [..., 3H].
        recurrent: the same of the hidden state, h W + b, [..., 3H].
        hidden: h_t [..., H].
    """
    size = hidden.shape[-1]
    gates = torch.sigmoid(driven[..., : 2 * size] + recurrent[..., : 2 * size])
    reset, update = gates.chunk(2, dim=-1)
    candidate = torch.tanh(driven[..., 2 * size :] + reset * recurrent[..., 2 * size :])
    return torch.lerp(candidate, hidden, update)


def gru(driven: Tensor, hidden: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """h_1 … h_T of `gru_cell`, without stopping in between.

    Args:
        driven: [T, ..., B, 3H].
        hidden: h_0 [..., B, H].
        weight: [..., H, 3H].
        bias: [..., 3H] or [..., 1, 3H], broadcast against `driven[0]`.

    Returns:
        [T, ..., B, H]
    """
    states: Tensor = _Gru.apply(driven, hidden, weight, bias)  # type: ignore[no-untyped-call]
    return states


class _Gru(torch.autograd.Function):
    """`gru`, its derivative written out (the chain rule on the equations of `gru_cell`)."""

    @staticmethod
    def forward(ctx: Any, driven: Tensor, hidden: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        steps, size = len(driven), hidden.shape[-1]
        states = driven.new_empty(steps + 1, *hidden.shape)
        states[0] = hidden
        gates = driven.new_empty(steps, *hidden.shape[:-1], 2 * size)  # r and u
        candidates, resets = torch.empty_like(states[1:]), torch.empty_like(states[1:])
        # Without the gradient in mind, one step's memory serves for all.
        keep = int(any(ctx.needs_input_grad))
        for step in range(steps):
            now, kept = states[step], step * keep
            recurrent = torch.matmul(now, weight).add_(bias)
            gate, reset, candidate = gates[kept], resets[kept], candidates[kept]
            torch.add(driven[step, ..., : 2 * size], recurrent[..., : 2 * size], out=gate)
            gate.sigmoid_()
            reset.copy_(recurrent[..., 2 * size :])
            torch.addcmul(driven[step, ..., 2 * size :], gate[..., :size], reset, out=candidate)
            candidate.tanh_()
            torch.lerp(candidate, now, gate[..., size:], out=states[step + 1])
        ctx.save_for_backward(states, gates, candidates, resets, weight)
        ctx.bias_shape = bias.shape
        return states[1:]

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        states, gates, candidates, resets, weight = ctx.saved_tensors
        (given,) = gradients
        size = states.shape[-1]
        d_driven = torch.empty(*gates.shape[:-1], 3 * size, dtype=gates.dtype, device=gates.device)
        d_recurrent = torch.empty_like(d_driven)
        # All that needs no carry from the later steps, for the whole sequence at once.
        reset, update = gates.chunk(2, dim=-1)
        candidate_slope = (1 - candidates.square()) * (1 - update)
        update_slope = update * (1 - update) * (states[:-1] - candidates)
        reset_slope = reset * (1 - reset) * resets
        transposed = weight.transpose(-1, -2)
        carry = torch.zeros_like(states[0])
        for step in range(len(gates) - 1, -1, -1):
            carry = carry + given[step]
            d_gate, d_hidden = d_driven[step], d_recurrent[step]
            d_candidate = torch.mul(carry, candidate_slope[step], out=d_gate[..., 2 * size :])
            torch.mul(carry, update_slope[step], out=d_gate[..., size : 2 * size])
            torch.mul(d_candidate, reset_slope[step], out=d_gate[..., :size])
            d_hidden[..., : 2 * size] = d_gate[..., : 2 * size]
            torch.mul(d_candidate, reset[step], out=d_hidden[..., 2 * size :])
            carry = torch.matmul(d_hidden, transposed).addcmul_(carry, update[step])
        # One product for all steps: [.., H, T·B] @ [.., T·B, 3H].
        before = torch.movedim(states[:-1], 0, -3).flatten(-3, -2)
        after = torch.movedim(d_recurrent, 0, -3).flatten(-3, -2)
        d_weight = torch.matmul(before.transpose(-1, -2), after)
        return d_driven, carry, d_weight, d_recurrent.sum(0).sum_to_size(ctx.bias_shape)
