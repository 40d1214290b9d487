"""The decoder of the CRPS generators: the next state from this one, by a feedforward network."""

import torch
from torch import Tensor, nn

from study.models.ensemble import StackedLinear
from study.models.rollout import Bounds, Weights, rollout

# On the first layer's initial weights. What matters may be narrow beside the range of the states:
# a peg touches a ball only within some hundredths of it. A smooth beginning takes long to see that.
SHARPNESS = 3.0
LAYERS = 2
# Of the range of the training states; so far beyond it a forecast may go.
MARGIN = 0.02
# Rows that are forecast at once: what drives the first layer is held for all of their steps.
ROWS = 1024


class TransitionDecoder(nn.Module):
    """ŝ_{t+1} from ŝ_t, the conditions, the baseline's change and the noise at t alone.

    It adds to a *baseline* b_{1:T} as `RecurrentDecoder` does: what it gives is the change of
    ε = s − b. States stay near the range of the training states: a flight that sinks ends on the
    ground, and what is fed back cannot run away.

    Args:
        change_scale: unit of the change in each dimension, [D].
        condition_size: C, what is known at every step beside the state.
        hidden_size: W.
        noise_size: Z.
        lasting: so many of the first components of the noise do nothing to begin with.
    """

    change_scale: Tensor
    lowest: Tensor
    highest: Tensor

    def __init__(
        self,
        change_scale: Tensor,
        condition_size: int,
        hidden_size: int,
        noise_size: int,
        lasting: int = 0,
    ) -> None:
        super().__init__()
        size = len(change_scale)
        self.register_buffer("change_scale", change_scale.clone())
        self.register_buffer("lowest", torch.full_like(change_scale, -torch.inf))
        self.register_buffer("highest", torch.full_like(change_scale, torch.inf))
        driving = size + condition_size + noise_size
        self.linear = nn.Linear(size + driving, size)
        self.first = nn.Linear(size + driving, 2 * hidden_size)
        self.layers = StackedLinear(LAYERS, hidden_size, hidden_size)  # one after the other
        self.out = nn.Linear(hidden_size, size, bias=False)
        with torch.no_grad():
            self.linear.weight.zero_()
            self.linear.bias.zero_()
            self.first.weight.mul_(SHARPNESS)
            self.first.bias.mul_(SHARPNESS)
            begin = 2 * size + condition_size
            self.first.weight[:, begin : begin + lasting] = 0
            self.out.weight.mul_(0.3)

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
            noise: z_{0:T-1} [B, T, Z].
        """
        given = (s0, baseline, condition, noise)
        if torch.is_grad_enabled():
            return self._forecast(*given)
        blocks = zip(*(each.split(ROWS) for each in given), strict=True)
        return torch.cat([self._forecast(*block) for block in blocks])

    def _forecast(self, s0: Tensor, baseline: Tensor, condition: Tensor, noise: Tensor) -> Tensor:
        drift = baseline[:, 1:] - baseline[:, :-1]
        weight = torch.cat([self.linear.weight, self.first.weight]).T
        feed, drive = weight.tensor_split([len(self.change_scale)])
        driving = torch.cat([drift / self.change_scale, condition, noise], -1)
        driven = driving @ drive + torch.cat([self.linear.bias, self.first.bias])
        layers = self.layers.weight, self.layers.bias[:, 0]
        weights = Weights(feed, *layers, self.out.weight.T)
        bounds = Bounds(self.lowest, self.highest)
        return rollout(s0, driven, drift, weights, self.change_scale, bounds)
