"""A gated recurrent unit that feeds its own output back, over a whole sequence at once.

On a CPU a network of this size spends its time not on arithmetic but on the bookkeeping of
thousands of small operations. So there the sequence is gone through in C (`recurrence.c`), forwards
and backwards; on a GPU, or without a C compiler, by `plain`, which is also how it is meant.
"""

from typing import Any

import torch
from torch import Tensor

from study.models.gru import native


def feedback_gru(
    inputs: Tensor,
    drift: Tensor,
    hidden: Tensor,
    state: Tensor,
    enter: Tensor,
    weight: Tensor,
    bias: Tensor,
    out: Tensor,
    keep: float,
    spread: Tensor | None = None,
    noise: Tensor | None = None,
    hiddens: bool = False,
) -> tuple[Tensor, Tensor]:
    """h_1 … h_T and s_1 … s_T of a GRU whose output state is fed back.

        x = [i_t, s_t] enter + bias_0,   g = h_t weight + bias_1
        r, u = σ(x + g),   n = tanh(x + r · g),   h_{t+1} = (1 − u) n + u h_t
        s_{t+1} = keep · s_t + h_{t+1} out + drift_t + exp(w_{t+1}) · noise_t
        w_{t+1} = tanh([h_{t+1}, 1] spread)

    (The GRU of Cho et al. 2014, in the form of `torch.nn.GRU`; r, u and n have a third each of
    the 3H components.) Leading axes `...`, none or one, are independent networks, side by side.

    Args:
        inputs: i, what drives the unit, [..., B, T, C].
        drift: what is added to the state, [..., B, T, D].
        hidden: h_0 [..., B, H].
        state: s_0 [..., B, D].
        enter: [..., C + D, 3H].
        weight: [..., H, 3H].
        bias: [..., 2, 3H].
        out: [..., H, D].
        keep: 1 where the unit gives the state's change, 0 where it gives the state.
        spread: of the noise, [..., H + 1, D]; it and `noise` only where no derivative is wanted.
        noise: [..., B, T, D].
        hiddens: whether h is wanted; else it may be empty.

    Returns:
        h [..., B, T, H] and s [..., B, T, D].
    """
    given = (inputs, drift, hidden, state, enter, weight, bias, out, keep, spread, noise)
    return _either(given, hiddens)


def gru(inputs: Tensor, hidden: Tensor, enter: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """h_1 … h_T [..., B, T, H] of the same unit without a state: see `feedback_gru`."""
    drift, state, out = (each[..., :0] for each in (inputs, hidden, weight))
    given = (inputs, drift, hidden, state, enter, weight, bias, out, 0.0, None, None)
    return _either(given, True)[0]


def _either(given: tuple[Any, ...], wanted: bool) -> tuple[Tensor, Tensor]:
    """Hidden states and states, compiled or not; compiled, only what the caller needs."""
    tensors = [each for each in given if isinstance(each, Tensor)]
    alike = all(each.device.type == "cpu" and each.dtype == torch.float32 for each in tensors)
    if alike and native.library() is not None:
        # Inside, autograd says of each argument whether it has a derivative, but not whether
        # one is wanted: without, what it takes is neither computed nor kept.
        hiddens, states = _Compiled.apply(*given, wanted, torch.is_grad_enabled())
        return hiddens, states
    return plain(*given)


def plain(
    inputs: Tensor,
    drift: Tensor,
    hidden: Tensor,
    state: Tensor,
    enter: Tensor,
    weight: Tensor,
    bias: Tensor,
    out: Tensor,
    keep: float,
    spread: Tensor | None = None,
    noise: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """`feedback_gru`, step by step in torch, which derives it as well."""
    driving, feeding = enter.split([inputs.shape[-1], state.shape[-1]], dim=-2)
    from_inputs, from_hidden = bias.split(1, dim=-2)
    # For all steps at once, and the sequence taken apart once: an index into it at every step
    # would cost the derivative a copy of the whole each time.
    driven = inputs @ driving.unsqueeze(-3) + from_inputs.unsqueeze(-3)
    draws = [None] * drift.shape[-2] if noise is None else noise.unbind(-2)
    hiddens, states = [], []
    for entering, drifting, drawn in zip(driven.unbind(-2), drift.unbind(-2), draws, strict=True):
        x = entering + state @ feeding
        g = hidden @ weight + from_hidden
        (x_r, x_u, x_n), (g_r, g_u, g_n) = x.chunk(3, dim=-1), g.chunk(3, dim=-1)
        reset, update = torch.sigmoid(x_r + g_r), torch.sigmoid(x_u + g_u)
        hidden = torch.lerp(torch.tanh(x_n + reset * g_n), hidden, update)
        state = keep * state + hidden @ out + drifting
        if drawn is not None:
            assert spread is not None
            width = hidden @ spread[..., :-1, :] + spread[..., -1:, :]
            state = state + torch.exp(torch.tanh(width)) * drawn
        hiddens.append(hidden)
        states.append(state)
    return torch.stack(hiddens, dim=-2), torch.stack(states, dim=-2)


class _Compiled(torch.autograd.Function):
    """`feedback_gru` in C; only the weights' derivatives, sums over all steps, are torch's."""

    @staticmethod
    def forward(ctx: Any, *arguments: Any) -> tuple[Tensor, Tensor]:
        *given, keep, spread, noise, wanted, derive = arguments
        library = native.library()
        assert library is not None
        tensors = tuple(tensor.contiguous() for tensor in given)
        added = tuple(None if each is None else each.contiguous() for each in (spread, noise))
        inputs, drift, hidden, _, enter, weight, _, out = tensors
        *_, batch, steps, width = inputs.shape
        *members, _, size = hidden.shape
        sizes = (batch, steps, width, drift.shape[-1], size)
        ctx.count = members[0] if members else 1
        rows = (*members, batch, steps + 1)
        states = inputs.new_empty(*rows, drift.shape[-1])
        hiddens = seen = gates = None
        derive = derive and any(ctx.needs_input_grad)
        assert noise is None or not derive, "noise has no derivative here"
        if derive or wanted:
            hiddens = inputs.new_empty(*rows, size)
        if derive:
            seen = inputs.new_empty(*rows, enter.shape[-2] + 1)
            gates = inputs.new_empty(*members, batch, steps, 4 * size)
            ctx.save_for_backward(enter, weight, out, hiddens, gates, seen)
        arrays = (*tensors, *added, hiddens, states, seen, gates)
        native.call(library.forward, ctx.count, sizes, keep, arrays)
        ctx.sizes, ctx.keep = sizes, keep
        ctx.set_materialize_grads(False)
        nothing = states[..., :0]
        return (nothing if hiddens is None else hiddens)[..., 1:, :], states[..., 1:, :]

    @staticmethod
    def backward(ctx: Any, *given: Tensor | None) -> tuple[Tensor | None, ...]:
        enter, weight, out, hiddens, gates, seen = ctx.saved_tensors
        batch, steps, width, _, size = ctx.sizes
        of_hiddens, of_states = (None if x is None else x.contiguous() for x in given)
        library = native.library()
        assert library is not None
        rows = hiddens.shape[:-1]
        sums = hiddens.new_empty(*rows, 4 * size)  # by g_n, r, u and x_n
        of_drift = hiddens.new_empty(*rows, out.shape[-1])
        of_hidden = torch.empty_like(hiddens[..., 0, :])
        of_state = torch.empty_like(of_drift[..., 0, :])
        arrays = (enter, weight, out, hiddens, gates, of_hiddens, of_states)
        results = (sums, of_drift, of_hidden, of_state)
        native.call(library.backward, ctx.count, ctx.sizes, ctx.keep, arrays + results)
        # All steps of all trajectories in a row: h_t beside the derivatives by step t's sums.
        h, d, by_out, x = (each.flatten(-3, -2) for each in (hiddens, sums, of_drift, seen))
        of_weight = torch.roll(h.mT @ d[..., : 3 * size], -size, dims=-1)
        of_enter = x.mT @ d
        g_n, r, u, x_n = of_enter[..., -1, :].chunk(4, dim=-1)
        of_bias = torch.stack([torch.cat([r, u, x_n], -1), torch.cat([r, u, g_n], -1)], dim=-2)
        of_inputs = None
        if ctx.needs_input_grad[0]:
            driving = enter[..., :width, :].mT
            of_inputs = (d[..., size:] @ driving).unflatten(-2, (batch, steps + 1))[..., :-1, :]
        return (
            of_inputs,
            of_drift[..., :-1, :],
            of_hidden,
            of_state,
            of_enter[..., :-1, size:],
            of_weight,
            of_bias,
            (by_out[..., :-1, :].mT @ h[..., 1:, :]).mT,  # the other way round is slower
            *(None,) * 5,
        )
