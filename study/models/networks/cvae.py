"""The recurrent conditional VAE of Figure 2 (right) and the loss of equation (12).

One network serves both VAEs of the paper. It generates a *target* x_{1:T} that is added to a
*baseline* b_{1:T}: ŝ_t = x̂_t + b_t.

- residual VAE: b = ŷ_m, a sampled ensemble member, so that x = ε_alea = y_true − ŷ_m (equation 7);
- full VAE: b = 0, so that x is the state itself.
"""

import torch
from torch import Tensor, nn

from study.models.gru.recurrence import gru
from study.models.networks.gaussian_decoder import GaussianDecoder
from study.models.networks.likelihood import weighted_negative_log_likelihood


class RecurrentCvae(nn.Module):
    """Encoder q_φ(z_t | ·), prior p(z_t) = N(0, I), decoder p_θ(x_{t+1} | ŝ_{0:t}; a_{0:t}; z_t).

    Both are causal: nothing at step t depends on a later state, action or latent variable.

    Args:
        output_scale: unit of the decoder's output in each dimension, [D].
        condition_size: C, what is known at every step beside the state.
        hidden_size: width of both GRUs.
        latent_size: Z.
        increments: the decoder's output is x_{t+1} − x_t instead of x_{t+1}.
        one_width: the decoder's distribution has the same width at every step.
        sees_target: the encoder sees x_{t+1} beside s_t and the condition.
    """

    def __init__(
        self,
        output_scale: Tensor,
        condition_size: int,
        hidden_size: int,
        latent_size: int,
        increments: bool = False,
        one_width: bool = False,
        sees_target: bool = True,
    ) -> None:
        super().__init__()
        state_size = len(output_scale)
        self.sees_target = sees_target
        seen = state_size * (2 if sees_target else 1) + condition_size
        self.encoder_driven = nn.Linear(seen, 3 * hidden_size)
        self.encoder_recurrent = nn.Linear(hidden_size, 3 * hidden_size)
        self.posterior = nn.Linear(hidden_size, 2 * latent_size)
        self.decode = GaussianDecoder(
            output_scale, condition_size, hidden_size, latent_size, increments, one_width
        )

    def encode(self, target: Tensor, states: Tensor, condition: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log variance of q_φ(z_t | ·), each [B, T, Z].

        Args:
            target: x_{1:T} [B, T, D].
            states: s_{0:T-1} [B, T, D].
            condition: [B, T, C].
        """
        seen = [target, states, condition] if self.sees_target else [states, condition]
        entering, recurrent = self.encoder_driven, self.encoder_recurrent
        begin = target.new_zeros(len(target), recurrent.in_features)
        bias = torch.stack([entering.bias, recurrent.bias])
        enter, weight = entering.weight.T, recurrent.weight.T
        hidden = gru(torch.cat(seen, -1), begin, enter, weight, bias)
        mean, log_variance = self.posterior(hidden).chunk(2, dim=-1)
        return mean, log_variance.clamp(-12.0, 6.0)

    def loss(
        self, error: Tensor, log_width: Tensor, mean: Tensor, log_variance: Tensor, beta: float
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Equation (12), averaged over the batch and over t, and its two parts.

        The likelihood is weighted: see `weighted_negative_log_likelihood`.

            l_t = −E_q[log p_θ(s_{t+1} | ε̂_{t+1} + ŝ^m_{t+1})] + β KL[q_φ(z_t | ·) ‖ p(z_t)]

        Args:
            error: s_{1:T} − ŝ_{1:T} [B, T, D].
            log_width: w_{1:T} [B, T, D].
            mean, log_variance: of q_φ, [B, T, Z].
            beta: β.

        Returns:
            loss, negative log likelihood and KL divergence, scalars, and σ² of the batch [D].
        """
        by_dimension, variance = weighted_negative_log_likelihood(error, log_width)
        likelihood = by_dimension.sum()
        divergence = kl_from_standard_normal(mean, log_variance).mean()
        return likelihood + beta * divergence, likelihood, divergence, variance


def kl_from_standard_normal(mean: Tensor, log_variance: Tensor) -> Tensor:
    """KL[N(mean, exp(log_variance)) ‖ N(0, I)] summed over the last axis: [...] from [..., Z]."""
    return 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance).sum(-1)
