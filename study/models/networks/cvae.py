"""The recurrent conditional VAE of Figure 2 (right) and the loss of equation (12).

Both VAEs of the paper use this network. It generates a *target* x that is added to a *baseline* b:
ŝ_t = x̂_t + b_t.

- residual VAE: b = ŷ_m, a sampled ensemble member, so that x = ε_alea = y_true − ŷ_m (equation 8);
- full VAE: b = 0, so that x is the state itself.
"""

import torch
from torch import Tensor, nn

from study.models.gru.recurrence import gru
from study.models.networks.decoder import GaussianDecoder
from study.models.networks.likelihood import heteroscedastic_nll


class RecurrentCvae(nn.Module):
    """Encoder q_φ(z_t | ·), prior p(z_t) = N(0, I) and decoder p_θ(s_{t+1} | ·).

    The encoder is a GRU. Its inputs are [x_{t+1}, s_t, c_t], or [s_t, c_t] without the target:

        h_{t+1} = GRU([x_{t+1}, s_t, c_t], h_t),   h_0 = 0
        [μ_t, log ν_t] = h_{t+1} W + b,            q_φ(z_t | ·) = N(μ_t, ν_t)

    Encoder and decoder are causal: their outputs at step t do not depend on a later state,
    condition or latent variable. The only exception is the encoder's input x_{t+1}.

    Args:
        output_scale: the unit of the decoder's output in each dimension, [D].
        condition_size: C.
        hidden_size: H of both GRUs.
        latent_size: Z.
        delta_target: see `GaussianDecoder`.
        homoscedastic: see `GaussianDecoder`.
        uses_target: whether the target x_{t+1} is an input of the encoder.
    """

    def __init__(
        self,
        output_scale: Tensor,
        condition_size: int,
        hidden_size: int,
        latent_size: int,
        delta_target: bool = False,
        homoscedastic: bool = False,
        uses_target: bool = True,
    ) -> None:
        super().__init__()
        state_size = len(output_scale)
        self.uses_target = uses_target
        input_size = state_size * (2 if uses_target else 1) + condition_size
        self.encoder_gates_of_input = nn.Linear(input_size, 3 * hidden_size)
        self.encoder_gates_of_hidden = nn.Linear(hidden_size, 3 * hidden_size)
        self.posterior = nn.Linear(hidden_size, 2 * latent_size)
        self.decoder = GaussianDecoder(
            output_scale, condition_size, hidden_size, latent_size, delta_target, homoscedastic
        )

    def encode(self, target: Tensor, states: Tensor, condition: Tensor) -> tuple[Tensor, Tensor]:
        """Mean μ and log variance log ν of q_φ(z_t | ·), each [B, T, Z].

        Args:
            target: x_{1:T} [B, T, D].
            states: s_{0:T-1} [B, T, D].
            condition: c_{0:T-1} [B, T, C].
        """
        inputs = [target, states, condition] if self.uses_target else [states, condition]
        input_gates, hidden_gates = self.encoder_gates_of_input, self.encoder_gates_of_hidden
        initial = target.new_zeros(len(target), hidden_gates.in_features)
        bias = torch.stack([input_gates.bias, hidden_gates.bias])
        weight_ih, weight_hh = input_gates.weight.T, hidden_gates.weight.T
        hiddens = gru(torch.cat(inputs, -1), initial, weight_ih, weight_hh, bias)
        mean, log_variance = self.posterior(hiddens).chunk(2, dim=-1)
        return mean, log_variance.clamp(-12.0, 6.0)

    def loss(
        self, error: Tensor, log_std: Tensor, mean: Tensor, log_variance: Tensor, beta: float
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Equation (12), averaged over the batch and over t, and its two terms.

            l_t = −E_q[log p_θ(s_{t+1} | ε̂_{t+1} + ŝ^m_{t+1})] + β KL[q_φ(z_t | ·) ‖ p(z_t)]

        The likelihood is weighted: see `heteroscedastic_nll`.

        Args:
            error: s_{1:T} − ŝ_{1:T} [B, T, D].
            log_std: w_{1:T} [B, T, D].
            mean, log_variance: of q_φ, [B, T, Z].
            beta: β.

        Returns:
            loss, negative log-likelihood and KL divergence, scalars, and σ² of the batch [D].
        """
        nll_by_dimension, variance = heteroscedastic_nll(error, log_std)
        nll = nll_by_dimension.sum()
        divergence = kl_from_standard_normal(mean, log_variance).mean()
        return nll + beta * divergence, nll, divergence, variance


def kl_from_standard_normal(mean: Tensor, log_variance: Tensor) -> Tensor:
    """KL[N(μ, ν) ‖ N(0, I)] = ½ Σ (μ² + ν − 1 − log ν).

    Args:
        mean: μ [..., Z].
        log_variance: log ν [..., Z].

    Returns:
        [...], summed over the last axis.
    """
    return 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance).sum(-1)
