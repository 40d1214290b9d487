"""The feedforward decoder of the CRPS models: the next state from the current one."""

import torch
from torch import Tensor, nn
from torch.nn.functional import linear, pad, silu

from study.data.normalization import Normalization
from study.models.networks.linear import StackedLinear

INPUT_GAIN = 3.0
"""Factor on the initial weights of the first layer. A contact of a peg and a ball happens within
hundredths of the range of the states. An initially smooth network learns contacts slowly."""

LAYERS = 2
"""Number of residual layers."""

RANGE_MARGIN = 0.02
"""Fraction of the range of the training states by which a forecast may exceed that range."""

GRADIENT_DECAY = 0.8
"""Factor on the gradient of a state, at every step back. Every contact multiplies the gradient, so
the few forecasts with many contacts would dominate the full gradient."""

MAX_ROWS = 1024
"""Largest number of trajectories in one batch of forecasts. It bounds the memory."""


class TransitionDecoder(nn.Module):
    """ŝ_{t+1} from ŝ_t, s_0, the condition, the baseline's change and the noise of step t.

    The decoder adds its output to a *baseline* b, as `GaussianDecoder` does. The output is the
    change of ε = s − b, in units of δ, the standard deviation of a state's change over one step:

        [l, u, v] = [f(ŝ_t), (b_{t+1} − b_t) / δ, c_t, ζ, s_0] W + w
        h_0 = u · silu(v),   h_i = h_{i−1} + silu(h_{i−1} W_i + w_i)
        o_t = l + h_L O + z_t R + (h_L · z_t P) Q
        ŝ_{t+1} = min(max(ŝ_t + δ · o_t + b_{t+1} − b_t, s_min), s_max)

    - The product of two linear maps (Shazeer, arXiv:2002.05202) represents distances, and
      velocities of points on rotating bodies, in one layer.
    - The noise z_t of a step multiplies hidden units. So one step is Gaussian, with a variance that
      depends on the state. The persistent noise ζ is an input like the condition.
    - s_0 is an input, since a variable may return to its initial value (a wind to its mean).
    - The features f(ŝ) are ŝ and, for each angle ψ of `study.data.frames`, sin ψ, cos ψ, sin 2ψ and
      cos 2ψ: the rates of such an angle depend on the heading.
    - States stay within the range of the training states and a margin. So a sinking flight ends on
      the ground, and a state that is fed back cannot diverge.

    Args:
        normalization: δ and the angles.
        condition_size: C.
        hidden_size: H.
        noise_size: Z, the size of [ζ, z_t].
        persistent_size: the size of ζ, which has no effect before training.
    """

    delta_std: Tensor
    min_state: Tensor
    max_state: Tensor
    angles: Tensor
    angle_mean: Tensor
    angle_scale: Tensor

    def __init__(
        self,
        normalization: Normalization,
        condition_size: int,
        hidden_size: int,
        noise_size: int,
        persistent_size: int = 0,
    ) -> None:
        super().__init__()
        self.size, self.persistent_size = len(normalization.delta_std), persistent_size
        angles = torch.tensor(normalization.rotating_pairs)[:, 2].unique()
        self.register_buffer("angles", angles)
        self.register_buffer("angle_mean", torch.tensor(normalization.state_mean)[angles])
        self.register_buffer("angle_scale", torch.tensor(normalization.state_scale)[angles])
        self.register_buffer("delta_std", torch.tensor(normalization.delta_std))
        self.register_buffer("min_state", torch.full_like(self.delta_std, -torch.inf))
        self.register_buffer("max_state", torch.full_like(self.delta_std, torch.inf))
        self.features_size = self.size + 4 * len(angles)
        input_size = self.features_size + self.size + condition_size + persistent_size + self.size
        step_noise_size = noise_size - persistent_size
        self.skip = nn.Linear(input_size, self.size)  # l
        self.gates = nn.Linear(input_size, 2 * hidden_size)  # u and v
        self.layers = StackedLinear(LAYERS, hidden_size, hidden_size)  # W_i, in sequence
        self.output = nn.Linear(2 * hidden_size, self.size, bias=False)  # O and Q
        self.noise_gain = nn.Linear(step_noise_size, hidden_size, bias=False)  # P
        self.noise_shift = nn.Linear(step_noise_size, self.size, bias=False)  # R
        with torch.no_grad():
            self.skip.weight.zero_()
            self.skip.bias.zero_()
            self.gates.weight.mul_(INPUT_GAIN)
            self.gates.bias.mul_(INPUT_GAIN)
            self.gates.weight[:, input_size - persistent_size - self.size :] = 0
            self.output.weight.mul_(0.3)
            self.noise_shift.weight.mul_(0.3)

    @torch.no_grad()
    def set_range(self, states: Tensor) -> None:
        """Keep forecasts within the range of `states` [..., D] and a margin."""
        lowest, highest = torch.aminmax(states.flatten(0, -2), dim=0)
        margin = RANGE_MARGIN * (highest - lowest)
        self.min_state.copy_(lowest - margin)
        self.max_state.copy_(highest + margin)

    def forward(self, s0: Tensor, baseline: Tensor, condition: Tensor, noise: Tensor) -> Tensor:
        """ŝ_{1:T} [B, T, D].

        Args:
            s0: [B, D].
            baseline: b_{0:T} [B, T+1, D].
            condition: c_{0:T-1} [B, T, C].
            noise: [ζ, z_{0:T-1}] [B, T, Z], with the same ζ at every step.
        """
        inputs = (s0, baseline, condition, noise)
        if torch.is_grad_enabled():
            return self._unroll(*inputs)
        blocks = zip(*(values.split(MAX_ROWS) for values in inputs), strict=True)
        return torch.cat([self._unroll(*block) for block in blocks])

    def transition(
        self, state: Tensor, baseline_change: Tensor, condition: Tensor, start: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The Gaussian distribution of o_t without persistent noise.

        s_0 enters l alone. Through u and v it would identify the trajectory, and the training
        trajectories would be memorised.

        Args:
            state: ŝ_t [B, D].
            baseline_change: b_{t+1} − b_t [B, D].
            condition: c_t [B, C].
            start: s_0 [B, D].

        Returns:
            the mean [B, D] and a factor G [B, Z − persistent_size, D] of the covariance Gᵀ G:
            o_t = mean + z_t G.
        """
        inputs = torch.cat([self.features(state), baseline_change / self.delta_std, condition], -1)
        size = inputs.shape[-1]
        input_weight, start_weight = self.skip.weight[:, :size], self.skip.weight[:, -self.size :]
        skip = linear(inputs, input_weight, self.skip.bias) + start @ start_weight.T
        hidden = self._hidden(linear(inputs, self.gates.weight[:, :size], self.gates.bias))
        mean_weight, noise_weight = self.output.weight.T.chunk(2)
        # (h · P_z) Q for all components of z at once.
        gains = (self.noise_gain.weight[:, :, None] * noise_weight[:, None]).flatten(1)
        factor = (hidden @ gains).unflatten(1, (-1, self.size)) + self.noise_shift.weight.T
        return skip + hidden @ mean_weight, factor

    def features(self, state: Tensor) -> Tensor:
        """f(ŝ) [B, D + 4 · angles] of states [B, D]."""
        if not len(self.angles):
            return state
        angle = state[:, self.angles] * self.angle_scale + self.angle_mean
        sin, cos = angle.sin(), angle.cos()
        return torch.cat([state, sin, cos, 2 * sin * cos, cos * cos - sin * sin], -1)

    def _unroll(self, s0: Tensor, baseline: Tensor, condition: Tensor, noise: Tensor) -> Tensor:
        # An identity in the weights adds ŝ_t to l, and l is in units of the state.
        scale, identity = self.delta_std, torch.eye(self.features_size, self.size, device=s0.device)
        weight = torch.cat([self.skip.weight * scale[:, None], self.gates.weight]).T
        features_weight, inputs_weight = weight.tensor_split([self.features_size])
        features_weight = features_weight + pad(identity, (0, features_weight.shape[1] - self.size))
        baseline_change = baseline[:, 1:] - baseline[:, :-1]
        persistent, normal = noise.tensor_split([self.persistent_size], dim=-1)
        start = s0[:, None].expand(-1, baseline_change.shape[1], -1)
        inputs = torch.cat([baseline_change / scale, condition, persistent, start], -1)
        # Only the state depends on earlier steps. All other terms are computed for all steps first.
        terms = inputs @ inputs_weight + torch.cat([self.skip.bias * scale, self.gates.bias])
        skip, gates = terms.tensor_split([self.size], dim=-1)
        terms = torch.cat([skip + scale * self.noise_shift(normal) + baseline_change, gates], -1)
        output_weight = self.output.weight.T * scale
        state, states = s0, []
        for terms_t, gain in zip(terms.unbind(1), self.noise_gain(normal).unbind(1), strict=True):
            previous = state.view_as(state)
            if previous.requires_grad:
                previous.register_hook(_decay)
            preactivation = torch.addmm(terms_t, self.features(previous), features_weight)
            skip, gates = preactivation.tensor_split([self.size], dim=-1)
            hidden = self._hidden(gates)
            state = torch.addmm(skip, torch.cat([hidden, hidden * gain], -1), output_weight)
            state = torch.clamp(state, self.min_state, self.max_state)
            states.append(state)
        return torch.stack(states, dim=1)

    def _hidden(self, gates: Tensor) -> Tensor:
        """h_L from [u, v]."""
        u, v = gates.chunk(2, -1)
        hidden = u * silu(v)
        for weight, bias in zip(self.layers.weight, self.layers.bias, strict=True):
            hidden = hidden + silu(torch.addmm(bias, hidden, weight))
        return hidden


def _decay(gradient: Tensor) -> Tensor:
    return GRADIENT_DECAY * gradient
