"""The decoder of the CRPS generators: the next state from this one, by a feedforward network."""

import torch
from torch import Tensor, nn
from torch.nn.functional import linear as linear_map
from torch.nn.functional import pad, silu

from study.data.normalization import Normalization
from study.models.rnn_ensemble import StackedLinear

# On the first layer's initial weights. What matters may be narrow beside the range of the states:
# a peg touches a ball only within some hundredths of it. A smooth beginning takes long to see that.
SHARPNESS = 3.0
LAYERS = 2
# Of the range of the training states; so far beyond it a forecast may go.
MARGIN = 0.02
# Of the derivative by a state, what goes on to the state before it. All of it would be dominated by
# the few forecasts whose contacts have multiplied it many times; so credit ends after some steps.
CREDIT = 0.8
# Rows that are forecast at once: what drives the first layer is held for all of their steps.
ROWS = 1024


class TransitionDecoder(nn.Module):
    """ŝ_{t+1} from ŝ_t, the start, the conditions, the baseline's change and the noise at t alone.

    It adds to a *baseline* b_{1:T} as `RecurrentDecoder` does: what it gives is the change of
    ε = s − b.

        [l, u, v] = [ŝ_t, headings, (b_{t+1} − b_t) / scale, condition_t, ζ, s_0] W + w
        h_0 = u · silu(v),   h_i = h_{i−1} + silu(h_{i−1} W_i + w_i)
        c_t = l + h_L O + z_t C + (h_L · z_t P) Q
        ŝ_{t+1} = min(max(ŝ_t + scale · c_t + b_{t+1} − b_t, lowest), highest)

    - The product of two linear maps (Shazeer, arXiv:2002.05202) makes distances, and velocities of
      points on turning bodies, from their coordinates in one layer.
    - Noise z_t that is drawn at each step scales what the network knows, so a single step is normal
      and its width depends on the state; noise ζ that lasts is one more thing to know.
    - Something may return to where it began (a wind to its mean), so s_0 is seen throughout.
    - Headings are the sines and cosines of the angles by which pairs of the state are turned
      (`study.data.frames`), and of twice those: rates of such angles depend on the way one faces.
    - States stay near the range of the training states: a flight that sinks ends on the ground,
      and what is fed back cannot run away.

    Args:
        normalization: standard units.
        condition_size: C, what is known at every step beside the state.
        hidden_size: H.
        noise_size: Z, of which the first `lasting` are ζ.
        lasting: size of ζ, which does nothing to begin with.
    """

    delta_std: Tensor
    lowest: Tensor
    highest: Tensor
    angles: Tensor
    angle_mean: Tensor
    angle_scale: Tensor

    def __init__(
        self,
        normalization: Normalization,
        condition_size: int,
        hidden_size: int,
        noise_size: int,
        lasting: int = 0,
    ) -> None:
        super().__init__()
        self.size, self.lasting = len(normalization.delta_std), lasting
        angles = torch.tensor(normalization.rotating_pairs)[:, 2].unique()
        self.register_buffer("angles", angles)
        self.register_buffer("angle_mean", torch.tensor(normalization.state_mean)[angles])
        self.register_buffer("angle_scale", torch.tensor(normalization.state_scale)[angles])
        self.register_buffer("delta_std", torch.tensor(normalization.delta_std))
        self.register_buffer("lowest", torch.full_like(self.delta_std, -torch.inf))
        self.register_buffer("highest", torch.full_like(self.delta_std, torch.inf))
        self.seen_size = self.size + 4 * len(angles)
        entering = self.seen_size + self.size + condition_size + lasting + self.size
        drawn = noise_size - lasting
        self.linear = nn.Linear(entering, self.size)
        self.first = nn.Linear(entering, 2 * hidden_size)
        self.layers = StackedLinear(LAYERS, hidden_size, hidden_size)  # one after the other
        self.out = nn.Linear(2 * hidden_size, self.size, bias=False)
        self.modulate = nn.Linear(drawn, hidden_size, bias=False)
        self.shift = nn.Linear(drawn, self.size, bias=False)
        with torch.no_grad():
            self.linear.weight.zero_()
            self.linear.bias.zero_()
            self.first.weight.mul_(SHARPNESS)
            self.first.bias.mul_(SHARPNESS)
            self.first.weight[:, entering - lasting - self.size :] = 0
            self.out.weight.mul_(0.3)
            self.shift.weight.mul_(0.3)

    @torch.no_grad()
    def bound(self, states: Tensor) -> None:
        """Keep forecasts within the range of `states` [..., D], and a little more."""
        lowest, highest = torch.aminmax(states.flatten(0, -2), dim=0)
        margin = MARGIN * (highest - lowest)
        self.lowest.copy_(lowest - margin)
        self.highest.copy_(highest + margin)

    def forward(self, s0: Tensor, baseline: Tensor, condition: Tensor, noise: Tensor) -> Tensor:
        """ŝ_{1:T} [B, T, D].

        Args:
            s0: [B, D].
            baseline: b_{0:T} [B, T+1, D].
            condition: [B, T, C].
            noise: ζ and z_{0:T-1} [B, T, Z]; ζ is the same at every step.
        """
        given = (s0, baseline, condition, noise)
        if torch.is_grad_enabled():
            return self._forecast(*given)
        blocks = zip(*(each.split(ROWS) for each in given), strict=True)
        return torch.cat([self._forecast(*block) for block in blocks])

    def transition(
        self, state: Tensor, drift: Tensor, condition: Tensor, start: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The normal distribution of c_t without lasting noise: its mean, and a factor.

        s_0 is in l alone: u and v would take it for the trajectory's name, and learn the
        trajectories by heart.

        Args:
            state: ŝ_t [B, D].
            drift: b_{t+1} − b_t [B, D].
            condition: [B, C].
            start: s_0 of the trajectory [B, D].

        Returns:
            mean [B, D] and G [B, Z − lasting, D]: c_t = mean + z_t G, with covariance Gᵀ G.
        """
        entering = torch.cat([self._seen(state), drift / self.delta_std, condition], -1)
        known = entering.shape[-1]
        from_state, from_start = self.linear.weight[:, :known], self.linear.weight[:, -self.size :]
        linear = linear_map(entering, from_state, self.linear.bias) + start @ from_start.T
        hidden = self._hidden(linear_map(entering, self.first.weight[:, :known], self.first.bias))
        knows, spreads = self.out.weight.T.chunk(2)
        # (h · P_z) Q of every z at once.
        each = (self.modulate.weight[:, :, None] * spreads[:, None]).flatten(1)
        factor = (hidden @ each).unflatten(1, (-1, self.size)) + self.shift.weight.T
        return linear + hidden @ knows, factor

    def _forecast(self, s0: Tensor, baseline: Tensor, condition: Tensor, noise: Tensor) -> Tensor:
        # In units of the state, and with the state itself: what l gives is ŝ_t + scale · l + drift.
        scale, kept = self.delta_std, torch.eye(self.seen_size, self.size, device=s0.device)
        weight = torch.cat([self.linear.weight * scale[:, None], self.first.weight]).T
        feed, drive = weight.tensor_split([self.seen_size])
        feed = feed + pad(kept, (0, feed.shape[1] - self.size))
        drift = baseline[:, 1:] - baseline[:, :-1]
        lasts, drawn = noise.tensor_split([self.lasting], dim=-1)
        stays = s0[:, None].expand(-1, drift.shape[1], -1)
        driving = torch.cat([drift / scale, condition, lasts, stays], -1)
        driven = driving @ drive + torch.cat([self.linear.bias * scale, self.first.bias])
        linear, gates = driven.tensor_split([self.size], dim=-1)
        driven = torch.cat([linear + scale * self.shift(drawn) + drift, gates], -1)
        out = self.out.weight.T * scale
        state, states = s0, []
        for now, turned in zip(driven.unbind(1), self.modulate(drawn).unbind(1), strict=True):
            before = state.view_as(state)
            if before.requires_grad:
                before.register_hook(_credited)
            entered = torch.addmm(now, self._seen(before), feed)
            linear, gates = entered.tensor_split([self.size], dim=-1)
            hidden = self._hidden(gates)
            state = torch.addmm(linear, torch.cat([hidden, hidden * turned], -1), out)
            state = torch.clamp(state, self.lowest, self.highest)
            states.append(state)
        return torch.stack(states, dim=1)

    def _seen(self, state: Tensor) -> Tensor:
        """The state and its headings, [B, D + 4 angles]."""
        if not len(self.angles):
            return state
        angle = state[:, self.angles] * self.angle_scale + self.angle_mean
        sin, cos = angle.sin(), angle.cos()
        return torch.cat([state, sin, cos, 2 * sin * cos, cos * cos - sin * sin], -1)

    def _hidden(self, gates: Tensor) -> Tensor:
        """h_L, from [u, v]."""
        u, v = gates.chunk(2, -1)
        hidden = u * silu(v)
        for weight, bias in zip(self.layers.weight, self.layers.bias, strict=True):
            hidden = hidden + silu(torch.addmm(bias, hidden, weight))
        return hidden


def _credited(derivative: Tensor) -> Tensor:
    return CREDIT * derivative
