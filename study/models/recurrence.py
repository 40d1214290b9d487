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
    *members, size, gates = weight.shape
    feed, out = weight.new_empty(*members, 0, gates), weight.new_empty(*members, size, 0)
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
        hiddens = driven.new_empty(steps + 1, *hidden.shape)
        states = driven.new_empty(steps + 1, *state.shape)
        hiddens[0], states[0] = hidden, state
        # Without a derivative to come, one step's memory serves for all.
        kept = steps if any(ctx.needs_input_grad) else 1
        resets, updates, candidates, recurrents = driven.new_empty(4, kept, *hidden.shape)
        # A product of small matrices is twice as fast when the second one lies column by column.
        weight = weight.transpose(-1, -2).contiguous().transpose(-1, -2)
        xs, feeds_back, both = driven.unbind(0), state.shape[-1] > 0, 2 * size
        for t in range(steps):
            g = torch.matmul(hiddens[t], weight).add_(bias)
            x = torch.matmul(states[t], feed).add_(xs[t]) if feeds_back else xs[t]
            reset, update = torch.add(x[..., :both], g[..., :both]).sigmoid_().chunk(2, dim=-1)
            recurrent, candidate = recurrents[t % kept], candidates[t % kept]
            recurrent.copy_(g[..., both:])
            resets[t % kept], updates[t % kept] = reset, update
            torch.addcmul(x[..., both:], reset, recurrent, out=candidate).tanh_()
            torch.lerp(candidate, hiddens[t], update, out=hiddens[t + 1])
            if feeds_back:
                torch.matmul(hiddens[t + 1], out, out=states[t + 1])
                states[t + 1].add_(drift[t]).add_(states[t], alpha=keep)
        saved = (hiddens, states, resets, updates, candidates, recurrents, weight, feed, out)
        ctx.save_for_backward(*saved)
        ctx.keep, ctx.bias_shape = keep, bias.shape
        ctx.set_materialize_grads(False)
        return hiddens[1:], states[1:]

    @staticmethod
    def backward(ctx: Any, *given: Tensor | None) -> tuple[Tensor | None, ...]:
        hiddens, states, resets, updates, candidates, recurrents, weight, feed, out = (
            ctx.saved_tensors
        )
        size, feeds_back = hiddens.shape[-1], states.shape[-1] > 0
        of_hiddens, of_states = (() if x is None else x.unbind(0) for x in given)
        # All that needs no carry from the later steps, for the whole sequence at once.
        of_n = ((1 - candidates.square()) * (1 - updates)).unbind(0)
        of_u = (updates * (1 - updates) * (hiddens[:-1] - candidates)).unbind(0)
        of_r = (resets * (1 - resets) * recurrents).unbind(0)
        d_driven = hiddens.new_empty(len(of_n), *hiddens.shape[1:-1], 3 * size)
        d_given, d_drift = torch.empty_like(d_driven), torch.empty_like(states[1:])
        r_x, u_x, n_x = (part.unbind(0) for part in d_driven.chunk(3, dim=-1))
        n_g = d_given[..., 2 * size :].unbind(0)
        weight_t, feed_t, out_t = (x.transpose(-1, -2).contiguous() for x in (weight, feed, out))
        d_hidden, d_state = torch.zeros_like(hiddens[0]), torch.zeros_like(states[0])
        for t in range(len(of_n) - 1, -1, -1):
            if of_hiddens:
                d_hidden = d_hidden + of_hiddens[t]
            if feeds_back:
                d_state = d_state + of_states[t] if of_states else d_state
                d_drift[t] = d_state
                d_hidden = torch.matmul(d_state, out_t).add_(d_hidden)
            torch.mul(d_hidden, of_n[t], out=n_x[t])
            torch.mul(d_hidden, of_u[t], out=u_x[t])
            torch.mul(n_x[t], of_r[t], out=r_x[t])
            torch.mul(n_x[t], resets[t], out=n_g[t])
            d_given[t, ..., : 2 * size] = d_driven[t, ..., : 2 * size]
            d_hidden = torch.matmul(d_given[t], weight_t).addcmul_(d_hidden, updates[t])
            if feeds_back:
                d_state = torch.matmul(d_driven[t], feed_t).add_(d_state, alpha=ctx.keep)
        of_weight, of_bias = _over_steps(hiddens[:-1], d_given)
        return (
            d_driven,
            d_drift,
            d_hidden,
            d_state,
            of_weight,
            of_bias.sum_to_size(ctx.bias_shape),
            _over_steps(states[:-1], d_driven)[0] if feeds_back else torch.zeros_like(feed),
            _over_steps(hiddens[1:], d_drift)[0] if feeds_back else torch.zeros_like(out),
            None,
        )


def _over_steps(left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
    """Σ_{t, b} left ⊗ right [..., I, O] and Σ_{t, b} right [..., 1, O].

    Of [T, ..., B, I] and [T, ..., B, O].
    """
    left, right = (torch.movedim(x, 0, -3).flatten(-3, -2) for x in (left, right))
    return torch.matmul(left.transpose(-1, -2), right), right.sum(-2, keepdim=True)
