"""The recurrent conditional VAE of Figure 2 (right) and the loss of equation (12).

One network serves both VAEs of the paper. It generates a *target* x_{1:T} that is added to a
*baseline* b_{1:T}: ŝ_t = x̂_t + b_t.

- residual VAE: b = ŷ_m, a sampled ensemble member, so that x = ε_alea = y_true − ŷ_m (equation 7);
- full VAE: b = 0, so that x is the state itself.
"""

import math

import torch
from torch import Tensor, nn

from study.models.recurrence import gru, gru_cell


class RecurrentCvae(nn.Module):
    """Encoder q_φ(z_t | ·), prior p(z_t) = N(0, I), decoder p_θ(x_{t+1} | ŝ_{0:t}; a_{0:t}; z_{0:t}).

    Both are causal: nothing at step t depends on a later state, action or latent variable.

    Args:
        state_size: D.
        condition_size: C, what is known at every step beside the state.
        hidden_size: width of both GRUs.
        latent_size: Z.
        increments: the decoder's output is x_{t+1} − x_t instead of x_{t+1}.
        sees_target: the encoder sees x_{t+1} beside s_t and the condition.
        feeds_back: the decoder is fed the state ŝ_t. Without, it runs freely all the same: its own
            past predictions are a function of s_0, a_{0:t}, z_{0:t}, which its memory has seen.
    """

    def __init__(
        self,
        state_size: int,
        condition_size: int,
        hidden_size: int,
        latent_size: int,
        increments: bool = False,
        sees_target: bool = True,
        feeds_back: bool = True,
    ) -> None:
        super().__init__()
        self.increments, self.sees_target, self.feeds_back = increments, sees_target, feeds_back
        seen = state_size * (2 if sees_target else 1) + condition_size
        self.encoder_driven = nn.Linear(seen, 3 * hidden_size)
        self.encoder_recurrent = nn.Linear(hidden_size, 3 * hidden_size)
        self.posterior = nn.Linear(hidden_size, 2 * latent_size)
        self.start = nn.Sequential(nn.Linear(state_size + condition_size, hidden_size), nn.Tanh())
        # The decoder's GRU cell, taken apart: what is known beforehand is multiplied for the whole
        # horizon at once, and only the fed back state and the hidden state remain in the loop.
        self.known = nn.Linear(condition_size + latent_size, 3 * hidden_size)
        if feeds_back:
            self.fed_back = nn.Linear(state_size, 3 * hidden_size, bias=False)
        self.recurrent = nn.Linear(hidden_size, 3 * hidden_size)
        self.head = nn.Sequential(
            nn.Linear(hidden_size, hidden_size), nn.SiLU(), nn.Linear(hidden_size, state_size)
        )
        self.log_scale = nn.Parameter(torch.full((state_size,), math.log(0.3)))

    def encode(self, target: Tensor, states: Tensor, condition: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log variance of q_φ(z_t | ·), each [B, T, Z].

        Args:
            target: x_{1:T} [B, T, D].
            states: s_{0:T-1} [B, T, D].
            condition: [B, T, C].
        """
        seen = [target, states, condition] if self.sees_target else [states, condition]
        driven = self.encoder_driven(torch.cat(seen, -1).transpose(0, 1))
        begin = driven.new_zeros(len(target), self.encoder_recurrent.in_features)
        hidden = _gru(driven, begin, self.encoder_recurrent)
        mean, log_variance = self.posterior(hidden.transpose(0, 1)).chunk(2, dim=-1)
        return mean, log_variance.clamp(-12.0, 6.0)

    def decode(
        self,
        s0: Tensor,
        baseline: Tensor,
        condition: Tensor,
        latent: Tensor,
        truth: Tensor | None = None,
        own_share: float = 1.0,
    ) -> Tensor:
        """ŝ_{1:T} [B, T, D] from latent z_{0:T-1} [B, T, Z].

        Args:
            s0: [B, D].
            baseline: b_{0:T} [B, T+1, D].
            condition: [B, T, C].
            latent: [B, T, Z].
            truth: s_{0:T-1} [B, T, D], for teacher forcing.
            own_share: share of the steps, drawn at random, at which the decoder is fed its own
                prediction rather than the truth: 1 is free running, 0 teacher forcing.
        """
        begin = self.start(torch.cat([s0, condition[:, 0]], -1))
        known = self.known(torch.cat([condition, latent], -1).transpose(0, 1))
        if not self.feeds_back:
            output = self.head(_gru(known, begin, self.recurrent)).transpose(0, 1)
            first = s0 - baseline[:, 0]
            target = first[:, None] + output.cumsum(1) if self.increments else output
            return target + baseline[:, 1:]
        # Taken apart before the loop: to index a tensor inside it would make each step's backward
        # pass fill a gradient of the whole sequence's size.
        baselines = baseline.unbind(1)
        truths = truth.unbind(1) if truth is not None and own_share < 1 else None
        hidden, state, target, predictions = begin, s0, s0 - baselines[0], []
        for step, driven in enumerate(known.unbind(0)):
            if truths is not None and step > 0:
                own = torch.rand(len(s0), 1, device=s0.device) < own_share
                state = torch.where(own, state, truths[step])
                target = state - baselines[step]
            hidden = gru_cell(driven + self.fed_back(state), self.recurrent(hidden), hidden)
            output = self.head(hidden)
            target = target + output if self.increments else output
            state = target + baselines[step + 1]
            predictions.append(state)
        return torch.stack(predictions, dim=1)

    def loss(
        self, prediction: Tensor, truth: Tensor, mean: Tensor, log_variance: Tensor, beta: float
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Equation (12), averaged over the batch and over t, and its two parts.

            l_t = −E_q[log p_θ(s_{t+1} | ε̂_{t+1} + ŝ^m_{t+1})] + β KL[q_φ(z_t | ·) ‖ p(z_t)]

        Args:
            prediction: ŝ_{1:T} [B, T, D].
            truth: s_{1:T} [B, T, D].
            mean, log_variance: of q_φ, [B, T, Z].
            beta: β.

        Returns:
            loss, negative log likelihood and KL divergence, scalars.
        """
        likelihood = negative_log_likelihood(prediction, truth, self.log_scale).mean()
        divergence = kl_from_standard_normal(mean, log_variance).mean()
        return likelihood + beta * divergence, likelihood, divergence


def _gru(driven: Tensor, hidden: Tensor, recurrent: nn.Linear) -> Tensor:
    return gru(driven, hidden, recurrent.weight.T, recurrent.bias)


def negative_log_likelihood(prediction: Tensor, truth: Tensor, log_scale: Tensor) -> Tensor:
    """−log N(truth; prediction, exp(log_scale)²) summed over the last axis: [...] from [..., D].

    The scale is one learned number per dimension, so that dimensions whose noise differs by orders
    of magnitude weigh alike (Rybkin et al. 2021, sigma-VAE).
    """
    error = (truth - prediction) * torch.exp(-log_scale)
    constant = 0.5 * math.log(2 * math.pi)
    return (0.5 * error.square() + log_scale + constant).sum(-1)


def kl_from_standard_normal(mean: Tensor, log_variance: Tensor) -> Tensor:
    """KL[N(mean, exp(log_variance)) ‖ N(0, I)] summed over the last axis: [...] from [..., Z]."""
    return 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance).sum(-1)
