"""The dynamics network: the next state from the current one, in every model of the study.

A model is this network with a choice of inputs, memory, noise and loss:

===================== ================================= ======= ============================
model                 inputs beside the state           memory  noise
===================== ================================= ======= ============================
ensemble member       action                            GRU     none
VAE decoder           condition, latent variable        GRU     normal, `gaussian.py`
probabilistic MLP     action                            none    normal, `gaussian.py`
CRPS generator        condition, sum of actions, ζ, s_0 none    functional, `generator.py`
===================== ================================= ======= ============================
"""

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import pad, silu

from study.data.normalization import Normalization
from study.models.networks.architecture import Architecture
from study.models.networks.linear import StackedLinear
from study.models.unroll import graphs
from study.models.unroll.frame import direction, turn
from study.models.unroll.gru import gru
from study.models.unroll.unroll import Weights, features, unroll

INPUT_GAIN = 3.0
"""Factor on the initial weights of the stem. A contact of a peg and a ball happens within
hundredths of the range of the states. An initially smooth network learns contacts slowly."""

MAX_ROWS, MAX_GPU_ROWS = 240, 8192
"""Largest number of trajectories in one batch of forecasts. It bounds the memory."""


class DynamicsNetwork(nn.Module):
    """s_{t+1} from s_t and the inputs i_t, of M networks at once.

        x_t = [f(s_t), i_t]
        p_t = (x_t A + a) · silu(x_t B + b)                 stem
        h_{t+1} = GRU([x_t, p_t], h_t)                      memory
        h_0 = tanh([s_0, start] W_0 + w_0)
        y_t = p_t + [h_{t+1}, p_t] M + m
        y_t ← y_t + silu(y_t L_i + l_i)                     i = 1 … L
        s_{t+1} = k s_t + offset_t + u · (x_t S + s_0 R + y_t O + o)

    - The product of two linear maps (Shazeer, arXiv:2002.05202) represents distances, and
      velocities of points on rotating bodies, in one layer.
    - The features f(s) are s and, for each angle ψ of `study.data.frames`, sin ψ, cos ψ, sin 2ψ and
      cos 2ψ: the rates of such an angle depend on the heading.
    - s_0 has an effect, since a variable may return to its initial value (a wind to its mean).
      Through the stem it would identify a training trajectory, unless symmetries are applied.
    - k is 1 and u is δ, the standard deviation of a state's change over one step, or k is 0 and
      u is 1: see `Architecture.delta`. The offset is a baseline, or its change.
    - In a rollout, states stay within the range of the training states. So a sinking flight ends on
      the ground, and a state that is fed back cannot diverge.

    - In the canonical frame (`study.models.unroll.frame`), f is a function of s_t turned by −φ_t,
      and the change u · (…) is turned by φ_t.

    With `Architecture.product` off, f(s) = s, S = 0 and R = 0. Then y_t = h_{t+1} with memory, and
    p_t = silu(x_t B + b) without it.

    Args:
        normalization: δ and the angles.
        architecture: sizes.
    """

    unit: Tensor
    lowest: Tensor
    highest: Tensor
    angles: Tensor
    angle_mean: Tensor
    angle_scale: Tensor
    pairs: Tensor
    axis: Tensor
    axis_scale: Tensor
    gradient_decay = 1.0
    """Factor on the gradient of a state, at every step back."""

    def __init__(self, normalization: Normalization, architecture: Architecture) -> None:
        super().__init__()
        self.architecture = architecture
        delta_std = torch.tensor(normalization.delta_std)
        self.size = size = len(delta_std)
        angles = torch.tensor(normalization.rotating_pairs)[:, 2].unique()
        angles = angles if architecture.product else angles[:0]
        self.register_buffer("angles", angles)
        self.register_buffer("angle_mean", torch.tensor(normalization.state_mean)[angles])
        self.register_buffer("angle_scale", torch.tensor(normalization.state_scale)[angles])
        scale, axis = torch.tensor(normalization.state_scale), torch.tensor(normalization.axis)
        axis = axis if architecture.canonical else axis[:0]
        self.is_canonical = len(axis) > 0
        pairs = torch.tensor(normalization.turned_pairs)
        self.register_buffer("pairs", pairs if self.is_canonical else pairs[:0])
        self.register_buffer("axis", axis)
        self.register_buffer("axis_scale", scale[axis[:, 0]])
        unit = delta_std if architecture.delta else torch.ones_like(delta_std)
        self.register_buffer("unit", unit)
        self.register_buffer("lowest", torch.full_like(delta_std, -torch.inf))
        self.register_buffer("highest", torch.full_like(delta_std, torch.inf))
        count, stem = architecture.networks, architecture.stem_size
        memory = architecture.memory_size
        self.features_size = size + 4 * len(angles)
        x = self.features_size + architecture.inputs
        self.width = stem or memory
        self.output = StackedLinear(count, self.width, size)
        if architecture.product:
            self.skip = StackedLinear(count, x, size, bias=False)
            nn.init.zeros_(self.skip.weight)
        self.start_skip = None
        if architecture.product and architecture.linear_start:
            self.start_skip = StackedLinear(count, size, size, bias=False)
            nn.init.zeros_(self.start_skip.weight)
        if stem:
            self.stem = StackedLinear(count, x, stem * (2 if architecture.product else 1))
        if architecture.product:
            self.stem.weight.data.mul_(INPUT_GAIN)
        layers = [StackedLinear(count, stem, stem) for _ in range(architecture.layers_count)]
        self.layers = nn.ModuleList(layers)
        if memory:
            self.initial_hidden = StackedLinear(count, size + architecture.start, memory)
            self.gates = StackedLinear(count, x + stem, 3 * memory)
            self.gates_of_hidden = StackedLinear(count, memory, 3 * memory, bias=False)
            self.hidden_bias = nn.Parameter(torch.zeros(count, 1, memory))
        if memory and stem:
            self.mix = StackedLinear(count, memory + stem, stem)

    @torch.no_grad()
    def set_range(self, states: Tensor) -> None:
        """Keep rollouts within the range of `states` [..., D]."""
        lowest, highest = torch.aminmax(states.flatten(0, -2), dim=0)
        self.lowest.copy_(lowest)
        self.highest.copy_(highest)

    def step(
        self, state: Tensor, inputs: Tensor, hidden: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """The output and y of given states, of all steps at once (teacher forcing).

        Args:
            state: s_{0:T-1} [M, B, T, D]; without memory any [M, ..., D].
            inputs: i_{0:T-1} [M, B, T, I].
            hidden: h_0 [M, B, H], with memory.

        Returns:
            x_t S + y_t O + o [M, B, T, D], in units u and the canonical frame, and y [M, B, T, W].
        """
        if hidden is not None:
            return self.forward(state, inputs, hidden)
        output, top = graphs.call(self, state, inputs)
        return output, top

    def forward(
        self, state: Tensor, inputs: Tensor, hidden: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """See `step`."""
        f = features(
            self.to_canonical(state, state), self.angles, self.angle_mean, self.angle_scale
        )
        x, shape = torch.cat([f, inputs], -1), self.architecture
        p = None
        if shape.product:
            u, v = self._linear(self.stem, x).chunk(2, -1)
            p = u * silu(v)
        elif shape.stem_size:
            p = silu(self._linear(self.stem, x))
        top = p
        if shape.memory:
            gates = self._linear(self.gates, x if p is None else torch.cat([x, p], -1))
            assert hidden is not None
            top = gru(gates, hidden, self.gates_of_hidden.weight, self.hidden_bias[:, 0])
            if p is not None:
                top = p + self._linear(self.mix, torch.cat([top, p], -1))
        assert top is not None
        for layer in self.layers:
            top = top + silu(self._linear(layer, top))
        output = self._linear(self.output, top)
        if shape.product:
            output = output + self._linear(self.skip, x)
        return output.to(self.unit.dtype), top

    def to_canonical(self, values: Tensor, state: Tensor) -> Tensor:
        """Turn vectors [..., D], in normalised units or in units u, to the frame of a state."""
        if not self.is_canonical:
            return values
        cos, sin = direction(state, self.axis, self.axis_scale)
        return turn(values, self.pairs, cos, -sin)

    def start(self, s0: Tensor, start: Tensor) -> Tensor:
        """h_0 [M, B, H] from s_0 [M, B, D] and what else it depends on [M, B, `start`]."""
        if not self.architecture.memory:
            return s0[..., :0]
        return torch.tanh(self.initial_hidden(torch.cat([s0, start], -1)))

    def mean(
        self, state: Tensor, inputs: Tensor, offset: Tensor, hidden: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """ŝ_{t+1} [M, B, T, D] of given states from s_0 on, and y [M, B, T, W].

        The arguments are those of `step`, with offset [M, B, T, D].
        """
        output, top = self.step(state, inputs, hidden)
        previous = state if self.architecture.delta else 0.0
        offset = self._add_start(offset, state[:, :, 0])
        return previous + offset + self.unit * output, top

    def _add_start(self, offset: Tensor, start: Tensor) -> Tensor:
        """offset_t + u · s_0 R [M, B, T, D] from offset [M, B, T, D] and s_0 [M, B, D]."""
        if self.start_skip is None:
            return offset
        return offset + (self.unit * self.start_skip(start))[:, :, None]

    def rollout(
        self,
        s0: Tensor,
        inputs: Tensor,
        offset: Tensor,
        hidden: Tensor | None = None,
        gain: Tensor | None = None,
        noise: Tensor | None = None,
        return_tops: bool = False,
        start: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """s_{1:T} and y_{1:T}, each step from the state that was predicted last.

        Args:
            s0: [M, B, D].
            inputs: i_{0:T-1} [M, B, T, I].
            offset: [M, B, T, D], in the canonical frame.
            hidden: h_0 [M, B, H], with memory.
            gain: multiplicative noise [M, B, T, W]; see `generator.py`.
            noise: additive noise [M, B, T, D]; see `gaussian.py`.
            return_tops: whether y is needed. If not, it may be empty.
            start: the trajectory's s_0 [M, B, D], if the rollout begins at a later state.

        Returns:
            [M, B, T, D] and [M, B, T, W].
        """
        offset = self._add_start(offset, s0 if start is None else start)
        if hidden is None:
            hidden = s0[..., :0]
        values = (s0, inputs, offset, hidden, gain, noise)
        if torch.is_grad_enabled():
            return self._rollout(*values, return_tops=return_tops)
        rows = MAX_ROWS if s0.device.type == "cpu" else MAX_GPU_ROWS
        count = max(1, -(-s0.shape[1] // rows))  # a batch may be empty
        blocks = [(None,) * count if value is None else value.split(rows, 1) for value in values]
        parts = [
            self._rollout(*block, return_tops=return_tops) for block in zip(*blocks, strict=True)
        ]
        states, tops = zip(*parts, strict=True)
        return torch.cat(states, 1), torch.cat(tops, 1)

    def _rollout(
        self,
        s0: Tensor,
        inputs: Tensor,
        offset: Tensor,
        hidden: Tensor,
        gain: Tensor | None,
        noise: Tensor | None,
        *,
        return_tops: bool,
    ) -> tuple[Tensor, Tensor]:
        """See `rollout`. Terms that do not depend on the state are computed for all steps first."""
        weight, bias = self._weight_of_x()
        features_weight, inputs_weight = weight.split([self.features_size, inputs.shape[-1]], 1)
        # One product for all rows: a broadcast of the weights would copy them for every row.
        terms = torch.baddbmm(bias, inputs.flatten(1, 2), inputs_weight)
        terms = terms.unflatten(1, inputs.shape[1:3])
        terms = torch.cat([terms[..., : self.size] + offset, terms[..., self.size :]], -1)
        if self.architecture.delta and not self.is_canonical:  # adds s_t to l
            identity = torch.eye(self.features_size, self.size, device=s0.device)
            features_weight = features_weight + pad(identity, (0, weight.shape[2] - self.size))
        weights = self._weights(features_weight)
        decay = self.gradient_decay
        return unroll(weights, terms, s0, hidden, gain, noise, decay, return_tops, owner=self)

    def _weight_of_x(self) -> tuple[Tensor, Tensor]:
        """The weights [M, F + I, O] and biases [M, 1, O] of l, u, v and the gates."""
        shape, count = self.architecture, self.architecture.networks
        x = self.features_size + shape.inputs
        skip = self.skip.weight * self.unit if shape.product else self._zeros(count, x, self.size)
        weights, biases = [skip], [self.output.bias * self.unit]
        if shape.stem_size and not shape.product:  # u = 1
            weights.append(self._zeros(count, x, shape.stem_size))
            biases.append(1 + self._zeros(count, 1, shape.stem_size))
        if shape.stem_size:
            weights.append(self.stem.weight)
            biases.append(self.stem.bias)
        if shape.memory:
            weights.append(self.gates.weight[:, :x])
            biases.append(self.gates.bias)
        return torch.cat(weights, -1), torch.cat(biases, -1)

    def _weights(self, state: Tensor) -> Weights:
        """The weights of a rollout, with those of the features [M, F, O]."""
        shape, count = self.architecture, self.architecture.networks
        stem, memory = shape.stem_size, shape.memory_size
        mixes = bool(stem and memory)
        layers: list[Any] = list(self.layers)
        log_std, log_std_bias = self._log_std_weights()
        return Weights(
            state,
            self.gates.weight[:, -stem:] if mixes else self._zeros(count, stem, 3 * memory),
            self.gates_of_hidden.weight if memory else self._zeros(count, 0, 0),
            self.hidden_bias[:, 0] if memory else self._zeros(count, 0),
            self.mix.weight if mixes else self._zeros(count, 0, 0),
            self.mix.bias[:, 0] if mixes else self._zeros(count, 0),
            self._stack([layer.weight for layer in layers], (count, 0, stem, stem)),
            self._stack([layer.bias[:, 0] for layer in layers], (count, 0, stem)),
            self.output.weight * self.unit,
            self._noise_output(),
            log_std,
            log_std_bias,
            self.lowest,
            self.highest,
            self.angles,
            self.angle_mean,
            self.angle_scale,
            self.pairs,
            self.axis,
            self.axis_scale,
        )

    def _log_std_weights(self) -> tuple[Tensor | None, Tensor | None]:
        """The weights [M, W, D] and biases [M, D] of additive noise; see `gaussian.py`."""
        return None, None

    def _noise_output(self) -> Tensor | None:
        """The weights [M, W, D] of multiplicative noise; see `generator.py`."""
        return None

    def _zeros(self, *shape: int) -> Tensor:
        return self.unit.new_zeros(shape)

    def _stack(self, tensors: list[Tensor], empty: tuple[int, ...]) -> Tensor:
        return torch.stack(tensors, 1) if tensors else self._zeros(*empty)

    def _linear(self, layer: nn.Module, values: Tensor) -> Tensor:
        """A stacked layer on [M, ..., I]: one matrix product for all steps and trajectories."""
        rows = values.flatten(1, -2)
        result: Tensor = layer(rows)
        return result.unflatten(1, values.shape[1:-1])
