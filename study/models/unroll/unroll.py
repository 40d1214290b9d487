"""The dynamics network over a whole horizon, each step from the state that it predicted last.

On a CPU a loop in torch spends its time on the overhead of thousands of small operations. So the
whole horizon runs in C (`unroll.c`) on a CPU, forwards and backwards. On a GPU, or without a C
compiler, `torch_unroll` computes the same. The tests use it as the reference. On a GPU it is
captured in a CUDA graph (`graphs.py`).
"""

from dataclasses import dataclass, fields
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import silu

from study.models.precision import in_float32
from study.models.unroll import graphs, kernel
from study.models.unroll.frame import direction, turn

LOG_STD_BOUND = 1.0
"""Bound of |w|, the log standard deviation of additive noise relative to its unit."""


@dataclass(frozen=True)
class Weights:
    """The weights of M dynamics networks, as they are unrolled.

    F = D + 4K features, O = D + 2P + 3H, and W = P, or H without a stem (P = 0). Without memory
    H = 0. Columns of `state` are the output l, the stem's u and v, and the gates n, r and u;
    columns of `hidden` are r, u and n.

    Attributes:
        state: [M, F, O], from the features of s_t; without a canonical frame it includes s_t
            itself in l.
        gates: [M, P, 3H], from the stem to the gates n, r and u.
        hidden: [M, H, 3H], from h_t to the gates r, u and n.
        hidden_bias: [M, H], of the gate n.
        mix: [M, H + P, P], empty without stem or without memory.
        mix_bias: [M, P], likewise.
        layers: [M, L, W, W].
        layers_bias: [M, L, W].
        output: [M, W, D].
        noise_output: [M, W, D], of multiplicative noise; None without it.
        log_std: [M, W, D], of additive noise; None without it. Not differentiable.
        log_std_bias: [M, D], likewise.
        lowest, highest: [D], the bounds of a state.
        angle_columns: [K] int64, the angles among the state's components.
        angle_mean, angle_scale: [K], from normalised to SI units.
        pair_columns: [Q, 2] int64, the pairs that the canonical frame turns (`frame.py`); with
            Q = 0 there is no frame.
        axis_columns: [2, 2] int64, the points of its axis; empty without a frame.
        axis_scale: [2], from normalised to SI units; empty without a frame.
    """

    state: Tensor
    gates: Tensor
    hidden: Tensor
    hidden_bias: Tensor
    mix: Tensor
    mix_bias: Tensor
    layers: Tensor
    layers_bias: Tensor
    output: Tensor
    noise_output: Tensor | None
    log_std: Tensor | None
    log_std_bias: Tensor | None
    lowest: Tensor
    highest: Tensor
    angle_columns: Tensor
    angle_mean: Tensor
    angle_scale: Tensor
    pair_columns: Tensor
    axis_columns: Tensor
    axis_scale: Tensor

    def tensors(self) -> tuple[Tensor | None, ...]:
        """All weights, in the order of the attributes."""
        return tuple(getattr(self, entry.name) for entry in fields(self))


@in_float32
def unroll(
    weights: Weights,
    terms: Tensor,
    state: Tensor,
    hidden: Tensor,
    gain: Tensor | None = None,
    noise: Tensor | None = None,
    decay: float = 1.0,
    return_tops: bool = False,
    owner: object = None,
) -> tuple[Tensor, Tensor]:
    """s_{1:T} and y_{1:T} of networks whose state is fed back.

        [l, u, v, g] = terms_t + f(s_t) W_s,      f(s) = [s, sin ψ, cos ψ, sin 2ψ, cos 2ψ]
        p = u · silu(v)
        h_{t+1} = GRU(g + p W_g, h_t)
        y = p + [h_{t+1}, p] W_m + w_m            h_{t+1} alone without a stem, p without memory
        y ← y + silu(y W_i + w_i)                 i = 1 … L
        s_{t+1} = min(max(l + y W_o + (y · gain_t) W_q + exp(w) · noise_t, s_min), s_max)
        w = B tanh((y W_w + w_w) / B)

    With a canonical frame, f is a function of s_t turned by −φ. The sum that gives s_{t+1} is then
    the change of the state in that frame. It is turned by φ and added to s_t.

    The GRU is that of Cho et al. (2014), in the form of `torch.nn.GRU`. With D = 0 the networks
    have no state, and y is a sequence of hidden states.

    Args:
        weights: of M networks.
        terms: what does not depend on s_t, [M, B, T, O].
        state: s_0 [M, B, D].
        hidden: h_0 [M, B, H].
        gain: [M, B, T, W], multiplicative noise; None without it.
        noise: [M, B, T, D], additive noise; None without it. Not differentiable.
        decay: factor on the gradient of a state, at every step back.
        return_tops: whether y is needed. If not, it may be empty.
        owner: of the weights: keeps the CUDA graphs. None for none.

    Returns:
        s_{1:T} [M, B, T, D] and y_{1:T} [M, B, T, W].
    """
    arguments = (weights, terms, state, hidden, gain, noise, decay)
    tensors = [value for value in (*weights.tensors(), *arguments) if isinstance(value, Tensor)]
    supported = all(
        t.device.type == "cpu" and t.dtype in (torch.float32, torch.int64) for t in tensors
    )
    if supported and kernel.library() is not None:
        # Autograd disables gradients inside the function. So an argument says whether they are
        # needed. If not, the function does not write the tape of the backward pass.
        grad = torch.is_grad_enabled()
        inputs = (terms, state, hidden, gain, noise, decay, return_tops, grad)
        states, tops = _Compiled.apply(*inputs, *weights.tensors())
        return states, tops
    if owner is not None and graphs.are_used(terms.device):
        return _graphed(owner, *arguments, return_tops)
    return torch_unroll(*arguments)


def _graphed(owner: object, weights: Weights, *arguments: Any) -> tuple[Tensor, Tensor]:
    """`torch_unroll` as a CUDA graph of `owner`."""
    *inputs, decay, return_tops = arguments
    count, has_state = len(inputs), inputs[1].shape[-1] > 0

    def function(*tensors: Tensor | None) -> tuple[Tensor, ...]:
        values: Any = tensors
        terms, state, hidden, gain, noise = values[:count]
        of_weights = Weights(*values[count:])
        results = torch_unroll(of_weights, terms, state, hidden, gain, noise, decay)
        return results if return_tops or not has_state else results[:1]

    states, *tops = graphs.of(owner)(function, (*inputs, *weights.tensors()), (decay, return_tops))
    return states, tops[0] if tops else states[..., :0]


def torch_unroll(
    weights: Weights,
    terms: Tensor,
    state: Tensor,
    hidden: Tensor,
    gain: Tensor | None = None,
    noise: Tensor | None = None,
    decay: float = 1.0,
) -> tuple[Tensor, Tensor]:
    """`unroll` step by step in torch."""
    size, memory, stem = state.shape[-1], hidden.shape[-1], weights.gates.shape[1]
    steps = terms.shape[2]
    gains = [None] * steps if gain is None else gain.unbind(2)
    noises = [None] * steps if noise is None else noise.unbind(2)
    angles = (weights.angle_columns, weights.angle_mean, weights.angle_scale)
    layers = list(zip(weights.layers.unbind(1), weights.layers_bias.unbind(1), strict=True))
    has_frame = len(weights.pair_columns) > 0
    states, tops = [], []
    # Sequences are split once, since the gradient of an index at every step would copy the whole
    # sequence each time.
    for terms_t, gain_t, noise_t in zip(terms.unbind(2), gains, noises, strict=True):
        previous = state.view_as(state)
        if decay != 1 and previous.requires_grad:
            previous.register_hook(lambda gradient: decay * gradient)
        local = previous
        if has_frame:
            cos, sin = direction(previous, weights.axis_columns, weights.axis_scale)
            local = turn(previous, weights.pair_columns, cos, -sin)
        sums = terms_t + features(local, *angles) @ weights.state
        skip, u, v, gates = sums.split([size, stem, stem, 3 * memory], dim=-1)
        top = u * silu(v)
        if memory:
            hidden = _gru(weights, gates + top @ weights.gates, hidden)
        if memory and stem:
            mixed = torch.cat([hidden, top], -1) @ weights.mix
            top = top + mixed + weights.mix_bias[:, None]
        elif memory:
            top = hidden
        for layer, bias in layers:
            top = top + silu(top @ layer + bias[:, None])
        state = skip + top @ weights.output
        if gain_t is not None:
            assert weights.noise_output is not None
            state = state + (top * gain_t) @ weights.noise_output
        if noise_t is not None:
            assert weights.log_std is not None
            assert weights.log_std_bias is not None
            w = bounded(top @ weights.log_std + weights.log_std_bias[:, None])
            state = state + torch.exp(w) * noise_t
        if has_frame:
            state = previous + turn(state, weights.pair_columns, cos, sin)
        state = torch.clamp(state, weights.lowest, weights.highest)
        states.append(state)
        tops.append(top)
    return torch.stack(states, dim=2), torch.stack(tops, dim=2)


def bounded(values: Tensor) -> Tensor:
    """B tanh(x / B) [...], with B = `LOG_STD_BOUND`."""
    return LOG_STD_BOUND * torch.tanh(values / LOG_STD_BOUND)


def features(state: Tensor, columns: Tensor, mean: Tensor, scale: Tensor) -> Tensor:
    """f(s) = [s, sin ψ, cos ψ, sin 2ψ, cos 2ψ] [..., F] of states [..., D].

    Args:
        state: [..., D] in normalised units.
        columns: of the angles ψ, [K].
        mean, scale: of the angles, from normalised to SI units, [K].
    """
    if not len(columns):
        return state
    angle = state[..., columns] * scale + mean
    sin, cos = angle.sin(), angle.cos()
    return torch.cat([state, sin, cos, 2 * sin * cos, cos * cos - sin * sin], -1)


def _gru(weights: Weights, gates: Tensor, hidden: Tensor) -> Tensor:
    """h_{t+1} from the sums of the gates n, r and u without those of h_t, and h_t."""
    x_n, x_r, x_u = gates.chunk(3, dim=-1)
    g_r, g_u, g_n = (hidden @ weights.hidden).chunk(3, dim=-1)
    r, u = torch.sigmoid(x_r + g_r), torch.sigmoid(x_u + g_u)
    n = torch.tanh(x_n + r * (g_n + weights.hidden_bias[:, None]))
    return torch.lerp(n, hidden, u)  # (1 − u) n + u h


class _Compiled(torch.autograd.Function):
    """`unroll` in C.

    The gradients of the weights are sums over all steps and rows: matrix products of torch.
    """

    @staticmethod
    def forward(ctx: Any, *arguments: Any) -> tuple[Tensor, Tensor]:
        *arrays, decay, return_tops, grad_enabled = arguments[:8]
        inputs: tuple[Any, ...] = tuple(_contiguous(array) for array in arrays)
        terms, *_, noise = inputs
        of_weights: list[Any] = [_contiguous(array) for array in arguments[8:]]
        weights = Weights(*of_weights)
        count, batch, steps, _ = terms.shape
        sizes = kernel.Sizes.of(weights, batch, steps, decay, LOG_STD_BOUND)
        rows = (count, batch, steps)
        states = terms.new_empty(*rows, sizes.state)
        needs_gradient = grad_enabled and any(ctx.needs_input_grad)
        assert noise is None or not needs_gradient, "noise is not differentiable"
        tops = terms.new_empty(*rows, sizes.width) if return_tops or not sizes.state else None
        tape = terms.new_empty(*rows, sizes.tape_size()) if needs_gradient else None
        kernel.forward(sizes, weights, inputs, states, tops, tape)
        if needs_gradient:
            ctx.sizes = sizes
            ctx.save_for_backward(*inputs, states, tape, *weights.tensors())
        ctx.set_materialize_grads(False)
        return states, states[..., :0] if tops is None else tops

    @staticmethod
    def backward(ctx: Any, *results: Tensor | None) -> tuple[Tensor | None, ...]:
        *inputs, states, tape = ctx.saved_tensors[:7]
        weights, sizes = Weights(*ctx.saved_tensors[7:]), ctx.sizes
        terms, state, hidden, gain, _ = inputs
        gradients = terms.new_empty(*terms.shape[:3], sizes.gradients_size())
        grad_gain = None if gain is None else torch.empty_like(gain)
        grad_state, grad_hidden = torch.empty_like(state), torch.empty_like(hidden)
        grad_results = tuple(_contiguous(result) for result in results)
        computed = (gradients, grad_gain, grad_state, grad_hidden)
        kernel.backward(sizes, weights, tuple(inputs), states, tape, grad_results, computed)
        grad_terms = gradients[..., : terms.shape[-1]]
        of_inputs = (grad_terms, grad_state, grad_hidden, grad_gain, None, None, None, None)
        return of_inputs + _weight_gradients(sizes, weights, tape, gradients, gain)


def _weight_gradients(
    sizes: kernel.Sizes, weights: Weights, tape: Tensor, gradients: Tensor, gain: Tensor | None
) -> tuple[Tensor | None, ...]:
    """The gradients of `Weights.tensors()`: products over all steps and rows."""
    values = sizes.split_tape(tape.flatten(1, 2))
    f, before, stem, mixed, tops = values
    grads = gradients.flatten(1, 2)
    terms, x_gates, h_gates, mix, sums = sizes.split_gradients(grads)
    output = grads[..., : sizes.state]
    noise_output = None
    if gain is not None:
        noise_output = (tops[-1] * gain.flatten(1, 2)).mT @ output
    layers = [top.mT @ grad for top, grad in zip(tops, sums, strict=False)]
    return (
        f.mT @ terms,
        stem.mT @ x_gates,
        before.mT @ h_gates,
        h_gates[..., 2 * sizes.memory :].sum(1),
        mixed.mT @ mix if sizes.has_mix else torch.zeros_like(weights.mix),
        mix.sum(1) if sizes.has_mix else torch.zeros_like(weights.mix_bias),
        torch.stack(layers, 1) if layers else torch.zeros_like(weights.layers),
        torch.stack([grad.sum(1) for grad in sums], 1)
        if layers
        else torch.zeros_like(weights.layers_bias),
        tops[-1].mT @ output,
        noise_output,
        *(None,) * 10,
    )


def _contiguous(array: Tensor | None) -> Tensor | None:
    return None if array is None else array.contiguous()
