"""The recurrent conditional VAE of Figure 2 (right) and the KL divergence of equation (12).

Both VAEs of the paper use this network. It generates a *target* x that is added to a *baseline* b:
ŝ_t = x̂_t + b_t.

- residual VAE: b = ŷ_m, a sampled ensemble member, so that x = ε_alea = y_true − ŷ_m (equation 8);
- full VAE: b = 0, so that x is the state itself.
"""

import torch
from torch import Tensor, nn

from study.data.normalization import Normalization
from study.models.networks.architecture import Architecture
from study.models.networks.gaussian import GaussianDynamics
from study.models.unroll.gru import gru


class RecurrentCvae(nn.Module):
    """Encoder q_φ(z_t | ·), prior p(z_t) = N(0, I) and decoder p_θ(s_{t+1} | ·).

    The encoder is a GRU. Its inputs are [x_{t+1}, s_t, c_t], or [s_t, c_t] without the target:

        h_{t+1} = GRU([x_{t+1}, s_t, c_t], h_t),   h_0 = 0
        [μ_t, log ν_t] = h_{t+1} W + b,            q_φ(z_t | ·) = N(μ_t, ν_t)

    The decoder is a `GaussianDynamics` with memory. Its inputs are [c_t, z_t], and its offset is
    the baseline b_{t+1}, or the baseline's change where the target is a change.

    Encoder and decoder are causal: their outputs at step t do not depend on a later state,
    condition or latent variable. The only exception is the encoder's input x_{t+1}.

    Args:
        normalization: see `DynamicsNetwork`.
        architecture: of the decoder; its inputs are [c_t, z_t].
        latent_size: Z.
        homoscedastic: see `GaussianDynamics`.
        uses_target: whether the target x_{t+1} is an input of the encoder.
    """

    def __init__(
        self,
        normalization: Normalization,
        architecture: Architecture,
        latent_size: int,
        homoscedastic: bool = False,
        uses_target: bool = True,
    ) -> None:
        super().__init__()
        self.uses_target, self.delta = uses_target, architecture.delta
        self.decoder = GaussianDynamics(normalization, architecture, homoscedastic)
        states, condition_size = self.decoder.size, architecture.inputs - latent_size
        input_size = states * (2 if uses_target else 1) + condition_size
        hidden_size = architecture.memory_size
        self.encoder_gates_of_input = nn.Linear(input_size, 3 * hidden_size)
        self.encoder_gates_of_hidden = nn.Linear(hidden_size, 3 * hidden_size, bias=False)
        self.encoder_bias = nn.Parameter(torch.zeros(hidden_size))
        self.posterior = nn.Linear(hidden_size, 2 * latent_size)

    def encode(self, target: Tensor, states: Tensor, condition: Tensor) -> tuple[Tensor, Tensor]:
        """Mean μ and log variance log ν of q_φ(z_t | ·), each [B, T, Z].

        Args:
            target: x_{1:T} [B, T, D].
            states: s_{0:T-1} [B, T, D].
            condition: c_{0:T-1} [B, T, C].
        """
        inputs = [target, states, condition] if self.uses_target else [states, condition]
        gates = self.encoder_gates_of_input(torch.cat(inputs, -1))
        initial = target.new_zeros(1, len(target), len(self.encoder_bias))
        weight = self.encoder_gates_of_hidden.weight.T
        hiddens = gru(gates[None], initial, weight[None], self.encoder_bias[None])[0]
        mean, log_variance = self.posterior(hiddens).to(hiddens.dtype).chunk(2, dim=-1)
        return mean, log_variance.clamp(-12.0, 6.0)

    def decode(
        self,
        s0: Tensor,
        baseline: Tensor,
        condition: Tensor,
        latent: Tensor,
        truth: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """The means ŝ_{1:T} and the log standard deviations w_{1:T}, relative to σ: [B, T, D] each.

        Args:
            s0: [B, D].
            baseline: b_{0:T} [B, T+1, D].
            condition: c_{0:T-1} [B, T, C].
            latent: z_{0:T-1} [B, T, Z].
            truth: s_{0:T-1} [B, T, D], the state history with teacher forcing. If None, the state
                history is the decoder's own means.
        """
        start, inputs, offset, hidden = self._inputs(s0, baseline, condition, latent)
        if truth is None:
            mean, log_std = self.decoder.predict_rollout(start, inputs, offset, hidden)
        else:
            mean, log_std = self.decoder.predict(truth[None], inputs, offset, hidden)
        return mean[0], log_std[0]

    def sample(
        self, s0: Tensor, baseline: Tensor, condition: Tensor, latent: Tensor, normal: Tensor
    ) -> Tensor:
        """Sampled states s_{1:T} [B, T, D]. Each state is sampled from p_θ and fed back.

        Args:
            s0, baseline, condition, latent: see `decode`.
            normal: standard normal numbers [B, T, D].
        """
        start, inputs, offset, hidden = self._inputs(s0, baseline, condition, latent)
        return self.decoder.sample_rollout(start, inputs, offset, normal[None], hidden)[0]

    def _inputs(
        self, s0: Tensor, baseline: Tensor, condition: Tensor, latent: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """s_0, the decoder's inputs, the offset and h_0, with a leading axis of one network."""
        hidden = self.decoder.start(s0[None], condition[None, :, 0])
        # ŝ = x̂ + b, so a change of x̂ needs the change of b as well.
        offset = baseline.diff(dim=1) if self.delta else baseline[:, 1:]
        return s0[None], torch.cat([condition, latent], -1)[None], offset[None], hidden


def kl_from_standard_normal(mean: Tensor, log_variance: Tensor) -> Tensor:
    """KL[N(μ, ν) ‖ N(0, I)] = ½ Σ (μ² + ν − 1 − log ν).

    Args:
        mean: μ [..., Z].
        log_variance: log ν [..., Z].

    Returns:
        [...], summed over the last axis.
    """
    return 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance).sum(-1)
