"""A gated recurrent unit whose output state is fed back, over a whole sequence at once.

On a CPU a loop over `torch.nn.GRUCell` spends its time on the overhead of thousands of small
operations. So the whole sequence runs in C (`recurrence.c`) on a CPU, forwards and backwards. On a
GPU, or without a C compiler, `torch_gru` computes the same. The tests use it as the reference.
"""

from typing import Any

import torch
from torch import Tensor

from study.models.gru import kernel


def feedback_gru(
    inputs: Tensor,
    offset: Tensor,
    hidden: Tensor,
    state: Tensor,
    weight_ih: Tensor,
    weight_hh: Tensor,
    bias: Tensor,
    weight_ho: Tensor,
    residual: float,
    log_std_weight: Tensor | None = None,
    noise: Tensor | None = None,
    return_hiddens: bool = False,
) -> tuple[Tensor, Tensor]:
    """h_{1:T} and s_{1:T} of a GRU whose output state is fed back.

        x = [i_t, s_t] W_ih + b_ih,   g = h_t W_hh + b_hh
        r, u = σ(x + g),   n = tanh(x + r · g),   h_{t+1} = (1 − u) n + u h_t
        s_{t+1} = residual · s_t + h_{t+1} W_ho + offset_t + exp(w_{t+1}) · noise_t
        w_{t+1} = tanh([h_{t+1}, 1] W_std)

    (The GRU of Cho et al. 2014, in the form of `torch.nn.GRU`; r, u and n have a third each of
    the 3H components.) Leading axes `...`, none or one, are those of independent networks.

    Args:
        inputs: i_{0:T-1} [..., B, T, C].
        offset: [..., B, T, D].
        hidden: h_0 [..., B, H].
        state: s_0 [..., B, D].
        weight_ih: W_ih [..., C + D, 3H], rows of the inputs, then of the state.
        weight_hh: W_hh [..., H, 3H].
        bias: b_ih and b_hh [..., 2, 3H].
        weight_ho: W_ho [..., H, D].
        residual: 1 where the unit outputs the state's change, 0 where it outputs the state.
        log_std_weight: W_std [..., H + 1, D], the bias in the last row; None without noise.
        noise: [..., B, T, D]; None for the last term of s_{t+1} to be 0. Neither `noise` nor
            `log_std_weight` is differentiable.
        return_hiddens: whether h is needed. If not, h may be empty.

    Returns:
        h_{1:T} [..., B, T, H] and s_{1:T} [..., B, T, D].
    """
    arguments = (inputs, offset, hidden, state, weight_ih, weight_hh, bias, weight_ho, residual)
    return _dispatch((*arguments, log_std_weight, noise), return_hiddens)


def gru(
    inputs: Tensor, hidden: Tensor, weight_ih: Tensor, weight_hh: Tensor, bias: Tensor
) -> Tensor:
    """h_{1:T} [..., B, T, H] of the same unit without an output state: see `feedback_gru`."""
    offset, state, weight_ho = (values[..., :0] for values in (inputs, hidden, weight_hh))
    arguments = (inputs, offset, hidden, state, weight_ih, weight_hh, bias, weight_ho, 0.0)
    return _dispatch((*arguments, None, None), True)[0]


def _dispatch(arguments: tuple[Any, ...], return_hiddens: bool) -> tuple[Tensor, Tensor]:
    """The compiled kernel for float32 on a CPU, where it exists; else `torch_gru`."""
    tensors = [argument for argument in arguments if isinstance(argument, Tensor)]
    supported = all(t.device.type == "cpu" and t.dtype == torch.float32 for t in tensors)
    if supported and kernel.library() is not None:
        # Autograd disables gradients inside the function. So an argument says whether they are
        # needed. If not, the function does not compute the arrays of the backward pass.
        hiddens, states = _Compiled.apply(*arguments, return_hiddens, torch.is_grad_enabled())
        return hiddens, states
    return torch_gru(*arguments)


def torch_gru(
    inputs: Tensor,
    offset: Tensor,
    hidden: Tensor,
    state: Tensor,
    weight_ih: Tensor,
    weight_hh: Tensor,
    bias: Tensor,
    weight_ho: Tensor,
    residual: float,
    log_std_weight: Tensor | None = None,
    noise: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """`feedback_gru` step by step in torch."""
    input_weight, state_weight = weight_ih.split([inputs.shape[-1], state.shape[-1]], dim=-2)
    bias_ih, bias_hh = bias.split(1, dim=-2)
    # The terms of the inputs are computed for all steps at once. Sequences are split once, since
    # the gradient of an index at every step would copy the whole sequence each time.
    from_inputs = inputs @ input_weight.unsqueeze(-3) + bias_ih.unsqueeze(-3)
    noises = [None] * offset.shape[-2] if noise is None else noise.unbind(-2)
    steps = zip(from_inputs.unbind(-2), offset.unbind(-2), noises, strict=True)
    hiddens, states = [], []
    for x_inputs, offset_t, noise_t in steps:
        x = x_inputs + state @ state_weight
        g = hidden @ weight_hh + bias_hh
        (x_r, x_u, x_n), (g_r, g_u, g_n) = x.chunk(3, dim=-1), g.chunk(3, dim=-1)
        r, u = torch.sigmoid(x_r + g_r), torch.sigmoid(x_u + g_u)
        hidden = torch.lerp(torch.tanh(x_n + r * g_n), hidden, u)  # (1 − u) n + u h
        state = residual * state + hidden @ weight_ho + offset_t
        if noise_t is not None:
            assert log_std_weight is not None
            w = hidden @ log_std_weight[..., :-1, :] + log_std_weight[..., -1:, :]
            state = state + torch.exp(torch.tanh(w)) * noise_t
        hiddens.append(hidden)
        states.append(state)
    return torch.stack(hiddens, dim=-2), torch.stack(states, dim=-2)


class _Compiled(torch.autograd.Function):
    """`feedback_gru` in C.

    The gradients of the weights are sums over all steps and rows: matrix products of torch.
    """

    @staticmethod
    def forward(ctx: Any, *arguments: Any) -> tuple[Tensor, Tensor]:
        *arrays, residual, log_std_weight, noise, return_hiddens, grad_enabled = arguments
        library = kernel.library()
        assert library is not None
        tensors = tuple(array.contiguous() for array in arrays)
        noises = tuple(None if x is None else x.contiguous() for x in (log_std_weight, noise))
        inputs, offset, hidden, _, weight_ih, weight_hh, _, weight_ho = tensors
        *_, batch, steps, input_size = inputs.shape
        *members, _, hidden_size = hidden.shape
        sizes = (batch, steps, input_size, offset.shape[-1], hidden_size)
        ctx.count = members[0] if members else 1
        rows = (*members, batch, steps + 1)
        states = inputs.new_empty(*rows, offset.shape[-1])
        hiddens = gate_inputs = gates = None
        needs_gradient = grad_enabled and any(ctx.needs_input_grad)
        assert noise is None or not needs_gradient, "noise is not differentiable"
        if needs_gradient or return_hiddens:
            hiddens = inputs.new_empty(*rows, hidden_size)
        if needs_gradient:
            gate_inputs = inputs.new_empty(*rows, weight_ih.shape[-2] + 1)
            gates = inputs.new_empty(*members, batch, steps, 4 * hidden_size)
            ctx.save_for_backward(weight_ih, weight_hh, weight_ho, hiddens, gates, gate_inputs)
        results = (hiddens, states, gate_inputs, gates)
        kernel.call(library.forward, ctx.count, sizes, residual, (*tensors, *noises, *results))
        ctx.sizes, ctx.residual = sizes, residual
        ctx.set_materialize_grads(False)
        empty = states[..., :0]
        return (empty if hiddens is None else hiddens)[..., 1:, :], states[..., 1:, :]

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        weight_ih, weight_hh, weight_ho, hiddens, gates, gate_inputs = ctx.saved_tensors
        batch, steps, input_size, _, size = ctx.sizes
        grad_hiddens, grad_states = (None if x is None else x.contiguous() for x in gradients)
        library = kernel.library()
        assert library is not None
        rows = hiddens.shape[:-1]
        sums = hiddens.new_empty(*rows, 4 * size)  # gradients of the sums g_n, r, u and x_n
        grad_offset = hiddens.new_empty(*rows, weight_ho.shape[-1])
        grad_hidden = torch.empty_like(hiddens[..., 0, :])
        grad_state = torch.empty_like(grad_offset[..., 0, :])
        arrays = (weight_ih, weight_hh, weight_ho, hiddens, gates, grad_hiddens, grad_states)
        results = (sums, grad_offset, grad_hidden, grad_state)
        kernel.call(library.backward, ctx.count, ctx.sizes, ctx.residual, arrays + results)
        # One axis holds all steps of all trajectories: row t of h matches the gradients of step t.
        h, d, d_out, x = (
            values.flatten(-3, -2) for values in (hiddens, sums, grad_offset, gate_inputs)
        )
        grad_hh = torch.roll(h.mT @ d[..., : 3 * size], -size, dims=-1)
        grad_ih = x.mT @ d
        g_n, r, u, x_n = grad_ih[..., -1, :].chunk(4, dim=-1)
        grad_bias = torch.stack([torch.cat([r, u, x_n], -1), torch.cat([r, u, g_n], -1)], dim=-2)
        grad_inputs = None
        if ctx.needs_input_grad[0]:
            transposed = weight_ih[..., :input_size, :].mT
            grad_rows = (d[..., size:] @ transposed).unflatten(-2, (batch, steps + 1))
            grad_inputs = grad_rows[..., :-1, :]
        return (
            grad_inputs,
            grad_offset[..., :-1, :],
            grad_hidden,
            grad_state,
            grad_ih[..., :-1, size:],
            grad_hh,
            grad_bias,
            (d_out[..., :-1, :].mT @ h[..., 1:, :]).mT,  # the transposed product is slower
            *(None,) * 5,
        )
