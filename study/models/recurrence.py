"""A gated recurrent unit that feeds its own output back, over a whole sequence at once.

On a CPU a network of this size spends its time not on arithmetic but on the bookkeeping of
thousands of small operations. So the sequence is gone through, forwards and backwards, by hand, and
all that need not wait for the step before is done for the whole horizon at once.
"""

from typing import Any

import torch
from torch import Tensor


def feedback_gru(
    driven: Tensor,
    drift: Tensor,
    hidden: Tensor,
    state: Tensor,
    weight: Tensor,
    bias: Tensor,
    feed: Tensor,
    out: Tensor,
    keep: float,
) -> tuple[Tensor, Tensor]:
    """h_1 … h_T and s_1 … s_T of a GRU whose output state is fed back.

        x = driven_t + s_t feed,   g = h_t weight + bias
        r, u = σ(x + g),   n = tanh(x + r · g),   h_{t+1} = (1 − u) n + u h_t
        s_{t+1} = keep · s_t + h_{t+1} out + drift_t

    (The GRU of Cho et al. 2014, in the form of `torch.nn.GRU`; r, u and n have a third each of
    the 3H components.) Leading axes `...` are independent networks, side by side.

    Args:
        driven: what drives the unit, already multiplied, [T, ..., B, 3H].
        drift: what is added to the state, [T, ..., B, D].
        hidden: h_0 [..., B, H].
        state: s_0 [..., B, D].
        weight: [..., H, 3H].
        bias: [3H] or [..., 1, 3H].
        feed: [..., D, 3H].
        out: [..., H, D].
        keep: 1 where the unit gives the state's change, 0 where it gives the state.

    Returns:
        hidden states [T, ..., B, H] and states [T, ..., B, D].
    """
    hiddens, states = _FeedbackGru.apply(
        driven, drift, hidden, state, weight, bias, feed, out, keep
    )
    return hiddens, states


def gru(driven: Tensor, hidden: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """h_1 … h_T [T, ..., B, H] of the same unit without a state: see `feedback_gru`."""
    nothing = driven.new_empty(*hidden.shape[:-1], 0)
    feed, out = weight.new_empty(0, weight.shape[-1]), weight.new_empty(weight.shape[-2], 0)
    drift = driven.new_empty(len(driven), *nothing.shape)
    return feedback_gru(driven, drift, hidden, nothing, weight, bias, feed, out, 0.0)[0]


class _FeedbackGru(torch.autograd.Function):
    """`feedback_gru`, its derivative written out (the chain rule on the equations there)."""

    @staticmethod
    def forward(
        ctx: Any,
        driven: Tensor,
        drift: Tensor,
        hidden: Tensor,
        state: Tensor,
        weight: Tensor,
        bias: Tensor,
        feed: Tensor,
        out: Tensor,
        keep: float,
    ) -> tuple[Tensor, Tensor]:
        steps, size = len(driven), hidden.shape[-1]
        # Without a derivative to come, one step's memory serves for all.
        memory = steps if any(ctx.needs_input_grad) else 1
        hiddens = driven.new_empty(steps + 1, *hidden.shape)
        states = driven.new_empty(steps + 1, *state.shape)
        hiddens[0], states[0] = hidden, state
        gates = driven.new_empty(memory, *hidden.shape[:-1], 2 * size)  # r and u
        candidates, recurrents = driven.new_empty(2, memory, *hidden.shape)  # n, and its part of g
        for step in range(steps):
            inputs = torch.matmul(states[step], feed).add_(driven[step])
            given = torch.matmul(hiddens[step], weight).add_(bias)
            kept = step % memory
            gate, candidate, recurrent = gates[kept], candidates[kept], recurrents[kept]
            torch.add(inputs[..., : 2 * size], given[..., : 2 * size], out=gate)
            gate.sigmoid_()
            recurrent.copy_(given[..., 2 * size :])
            torch.addcmul(inputs[..., 2 * size :], gate[..., :size], recurrent, out=candidate)
            candidate.tanh_()
            torch.lerp(candidate, hiddens[step], gate[..., size:], out=hiddens[step + 1])
            torch.matmul(hiddens[step + 1], out, out=states[step + 1])
            states[step + 1].add_(drift[step]).add_(states[step], alpha=keep)
        ctx.save_for_backward(hiddens, states, gates, candidates, recurrents, weight, feed, out)
        ctx.keep, ctx.bias_shape = keep, bias.shape
        ctx.set_materialize_grads(False)
        return hiddens[1:], states[1:]

    @staticmethod
    def backward(ctx: Any, *given: Tensor | None) -> tuple[Tensor | None, ...]:
        hiddens, states, gates, candidates, recurrents, weight, feed, out = ctx.saved_tensors
        of_hiddens, of_states = given
        size = hiddens.shape[-1]
        reset, update = gates.chunk(2, dim=-1)
        # All that needs no carry from the later steps, for the whole sequence at once.
        of_candidate = (1 - candidates.square()) * (1 - update)
        of_update = update * (1 - update) * (hiddens[:-1] - candidates)
        of_reset = reset * (1 - reset) * recurrents
        d_inputs = gates.new_empty(*gates.shape[:-1], 3 * size)
        d_given, d_drift = torch.empty_like(d_inputs), torch.empty_like(states[1:])
        weight_t, feed_t, out_t = (tensor.transpose(-1, -2) for tensor in (weight, feed, out))
        d_hidden, d_state = torch.zeros_like(hiddens[0]), torch.zeros_like(states[0])
        for step in range(len(gates) - 1, -1, -1):
            if of_states is not None:
                d_state = d_state + of_states[step]
            if of_hiddens is not None:
                d_hidden = d_hidden + of_hiddens[step]
            d_drift[step] = d_state
            d_hidden = d_hidden + torch.matmul(d_state, out_t)
            d_x, d_g = d_inputs[step], d_given[step]
            d_n = torch.mul(d_hidden, of_candidate[step], out=d_x[..., 2 * size :])
            torch.mul(d_hidden, of_update[step], out=d_x[..., size : 2 * size])
            torch.mul(d_n, of_reset[step], out=d_x[..., :size])
            d_g[..., : 2 * size] = d_x[..., : 2 * size]
            torch.mul(d_n, reset[step], out=d_g[..., 2 * size :])
            d_hidden = torch.matmul(d_g, weight_t).addcmul_(d_hidden, update[step])
            d_state = torch.matmul(d_x, feed_t).add_(d_state, alpha=ctx.keep)
        return (
            d_inputs,
            d_drift,
            d_hidden,
            d_state,
            _product_over_steps(hiddens[:-1], d_given),
            d_given.sum(0).sum_to_size(ctx.bias_shape),
            _product_over_steps(states[:-1], d_inputs).sum_to_size(feed.shape),
            _product_over_steps(hiddens[1:], d_drift).sum_to_size(out.shape),
            None,
        )


def _product_over_steps(left: Tensor, right: Tensor) -> Tensor:
    """Σ_{t, b} left ⊗ right: [..., I, O] from [T, ..., B, I] and [T, ..., B, O]."""
    left, right = (torch.movedim(x, 0, -3).flatten(-3, -2) for x in (left, right))
    return torch.matmul(left.transpose(-1, -2), right)
