"""The recurrent conditional VAE of Figure 2 (right) and the loss of equation (12).

One network serves both VAEs of the paper. It generates a *target* x_{1:T} that is added to a
*baseline* b_{1:T}: ŝ_t = x̂_t + b_t.

- residual VAE: b = ŷ_m, a sampled ensemble member, so that x = ε_alea = y_true − ŷ_m (equation 7);
- full VAE: b = 0, so that x is the state itself.
"""

import torch
from torch import Tensor, nn

from study.models.decoder import RecurrentDecoder
from study.models.likelihood import negative_log_likelihood
from study.models.recurrence import gru


class RecurrentCvae(nn.Module):
    """Encoder q_φ(z_t | ·), prior p(z_t) = N(0, I), decoder p_θ(x_{t+1} | ŝ_{0:t}; a_{0:t}; z_t).

    Both are causal: nothing at step t depends on a later state, action or latent variable.

    Args:
        output_scale: unit of the decoder's output in each dimension, [D].
        condition_size: C, what is known at every step beside the state.
        hidden_size: width of both GRUs.
        latent_size: Z.
        increments: the decoder's output is x_{t+1} − x_t instead of x_{t+1}.
        sees_target: the encoder sees x_{t+1} beside s_t and the condition.
    """

    variance: Tensor
    """σ² of p_θ(s_{t+1} | ·) = N(ŝ_{t+1}, σ²) in each dimension, [D]: see `measure`."""

    def __init__(
        self,
        output_scale: Tensor,
        condition_size: int,
        hidden_size: int,
        latent_size: int,
        increments: bool = False,
        sees_target: bool = True,
    ) -> None:
        super().__init__()
        state_size = len(output_scale)
        self.sees_target = sees_target
        self.register_buffer("variance", torch.ones(state_size))
        seen = state_size * (2 if sees_target else 1) + condition_size
        self.encoder_driven = nn.Linear(seen, 3 * hidden_size)
        self.encoder_recurrent = nn.Linear(hidden_size, 3 * hidden_size)
        self.posterior = nn.Linear(hidden_size, 2 * latent_size)
        self.decode = RecurrentDecoder(
            output_scale, condition_size, hidden_size, latent_size, increments
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
        squared_error = (truth - prediction).square().mean((0, 1))
        likelihood = negative_log_likelihood(squared_error).sum()
        divergence = kl_from_standard_normal(mean, log_variance).mean()
        return likelihood + beta * divergence, likelihood, divergence

    @torch.no_grad()
    def measure(self, prediction: Tensor, truth: Tensor, share: float) -> None:
        """Take a batch into the running mean of σ², by the share given.

        `loss` has σ at its best for each batch; forecasts need the one of all data.

        Args:
            prediction: ŝ_{1:T} [B, T, D].
            truth: s_{1:T} [B, T, D].
            share: of this batch in the mean; 1 forgets what was before.
        """
        self.variance.lerp_((truth - prediction).square().mean((0, 1)), share)


def kl_from_standard_normal(mean: Tensor, log_variance: Tensor) -> Tensor:
    """KL[N(mean, exp(log_variance)) ‖ N(0, I)] summed over the last axis: [...] from [..., Z]."""
    return 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance).sum(-1)
