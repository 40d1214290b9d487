"""The recurrent decoder of Figure 2 (right), which the VAEs share."""

from typing import Any

import torch
from torch import Tensor, nn

from study.models.gru.recurrence import feedback_gru, gru


class RecurrentDecoder(nn.Module):
    """x̂_{t+1} from ŝ_{0:t}, the conditions and the latent variables up to t, and ŝ = x̂ + b.

    It generates a *target* x_{1:T} that is added to a *baseline* b_{1:T}. Nothing at step t depends
    on a later state, condition or latent variable.

    Args:
        output_scale: unit of the decoder's output in each dimension, [D].
        condition_size: C, what is known at every step beside the state.
        hidden_size: H.
        latent_size: Z.
        increments: the output is x_{t+1} − x_t instead of x_{t+1}.
    """

    output_scale: Tensor

    def __init__(
        self,
        output_scale: Tensor,
        condition_size: int,
        hidden_size: int,
        latent_size: int,
        increments: bool = False,
    ) -> None:
        super().__init__()
        state_size = len(output_scale)
        self.increments = increments
        self.register_buffer("output_scale", output_scale.clone())
        self.start = nn.Sequential(nn.Linear(state_size + condition_size, hidden_size), nn.Tanh())
        self.driven = nn.Linear(condition_size + latent_size, 3 * hidden_size)
        self.feed = nn.Linear(state_size, 3 * hidden_size, bias=False)
        self.recurrent = nn.Linear(hidden_size, 3 * hidden_size)
        self.out = nn.Linear(hidden_size, state_size)

    def forward(
        self,
        s0: Tensor,
        baseline: Tensor,
        condition: Tensor,
        latent: Tensor,
        truth: Tensor | None = None,
    ) -> Tensor:
        """ŝ_{1:T} [B, T, D].

        The state history is the decoder's own predictions, or with `truth` the observed states.

        Args:
            s0: [B, D].
            baseline: b_{0:T} [B, T+1, D].
            condition: [B, T, C].
            latent: z_{0:T-1} [B, T, Z].
            truth: s_{0:T-1} [B, T, D]: teacher forcing.
        """
        return self.unroll(s0, baseline, condition, latent, truth)[1]

    def unroll(
        self,
        s0: Tensor,
        baseline: Tensor,
        condition: Tensor,
        latent: Tensor,
        truth: Tensor | None = None,
        **noise: Any,
    ) -> tuple[Tensor, Tensor]:
        """Hidden states and ŝ_{1:T}; free running takes noise and `hiddens` of `feedback_gru`."""
        hidden = self.start(torch.cat([s0, condition[:, 0]], -1))
        inputs = torch.cat([condition, latent], -1)
        enter = torch.cat([self.driven.weight, self.feed.weight], -1).T
        weight, bias = self.recurrent.weight.T, torch.stack([self.driven.bias, self.recurrent.bias])
        out, offset = self.out.weight.T * self.output_scale, self.out.bias * self.output_scale
        # ŝ_{t+1} = x̂_{t+1} + b_{t+1}, and the state ŝ_t itself holds x̂_t + b_t.
        drift = baseline[:, 1:] - baseline[:, :-1] if self.increments else baseline[:, 1:]
        keep = float(self.increments)
        drift = drift + offset
        if truth is None:
            sequence = (inputs, drift, hidden, s0, enter, weight, bias, out, keep)
            return feedback_gru(*sequence, **noise)
        hiddens = gru(torch.cat([inputs, truth], -1), hidden, enter, weight, bias)
        return hiddens, keep * truth + hiddens @ out + drift
