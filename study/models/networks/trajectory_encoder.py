"""A latent variable of a whole trajectory: unobserved quantities that are constant."""

import math

import torch
from torch import Tensor, nn

from study.models.networks.cvae import kl_from_standard_normal

HIDDEN_SIZE = 64
"""Hidden units of the encoder."""
STEPS = 30
"""Largest number of steps of a trajectory that the encoder sees, evenly spaced."""
QUANTILES = 65
"""Quantiles that describe the distribution of the latent variable."""
RECENT = 4096
"""Latent samples of training from which the quantiles are estimated."""
UPDATE_EVERY = 50
"""Optimiser steps between two estimates of the quantiles."""


class TrajectoryEncoder(nn.Module):
    """q_φ(ζ | s_{0:T}; c_{0:T-1}) = N(μ, ν), from a whole training trajectory.

        [μ, log ν] = W · mean_t MLP([s_t, s_{t+1} − s_t, c_t]) + w

    ζ stands for an unobserved quantity that is constant over a trajectory, such as a payload, and
    that a whole trajectory reveals (Belkhale et al., RA-L 2021, arXiv:2004.11345). The mean over
    steps does not depend on their order, as in a neural process (Garnelo et al., 2018).

    A forecast does not know ζ. It samples ζ from the *aggregate posterior* of the training data,
    E q_φ(ζ | ·), which may differ from N(0, I) (Tomczak and Welling, AISTATS 2018). Its components
    are treated as independent. A component is a standard normal number x, mapped by the quantiles
    of the component: ζ = F⁻¹(Φ(x)).

    Args:
        inputs: size of [s_t, s_{t+1} − s_t, c_t].
        latent_size: of ζ.
    """

    quantiles: Tensor
    recent: Tensor

    def __init__(self, inputs: int, latent_size: int) -> None:
        super().__init__()
        self.network = nn.Sequential(
            nn.Linear(inputs, HIDDEN_SIZE),
            nn.SiLU(),
            nn.Linear(HIDDEN_SIZE, HIDDEN_SIZE),
            nn.SiLU(),
        )
        self.posterior = nn.Linear(HIDDEN_SIZE, 2 * latent_size)
        nn.init.zeros_(self.posterior.bias)
        self.posterior.weight.data.mul_(0.1)
        levels = torch.linspace(0.0, 1.0, QUANTILES).clamp(1 / RECENT, 1 - 1 / RECENT)
        normal = torch.special.ndtri(levels.double()).float()
        self.register_buffer("quantiles", normal[:, None].repeat(1, latent_size))
        self.register_buffer("recent", torch.zeros(0, latent_size), persistent=False)

    def forward(self, states: Tensor, changes: Tensor, condition: Tensor) -> tuple[Tensor, Tensor]:
        """A sample of ζ [B, Z], and the KL divergence from N(0, I) [B].

        Args:
            states: s_{0:T-1} [B, T, D].
            changes: s_{t+1} − s_t in units of their standard deviation [B, T, D].
            condition: c_{0:T-1} [B, T, C].
        """
        stride = math.ceil(states.shape[1] / STEPS)
        values = torch.cat([states, changes, condition], -1)[:, ::stride]
        moments = self.posterior(self.network(values).mean(1)).to(values.dtype)
        mean, log_variance = moments.chunk(2, -1)
        log_variance = log_variance.clamp(-8.0, 2.0)
        sample = mean + torch.exp(0.5 * log_variance) * torch.randn_like(mean)
        return sample, kl_from_standard_normal(mean, log_variance)

    @torch.no_grad()
    def update_prior(self, samples: Tensor, step: int) -> None:
        """Estimate the quantiles from recent samples of training, at every `UPDATE_EVERY`-th step.

        Args:
            samples: ζ [B, Z] of a batch.
            step: optimiser steps already taken.
        """
        self.recent = torch.cat([self.recent, samples.detach()])[-RECENT:]
        if step % UPDATE_EVERY == 0 and len(self.recent) > QUANTILES:
            levels = torch.linspace(0.0, 1.0, QUANTILES, device=samples.device)
            self.quantiles.copy_(torch.quantile(self.recent, levels, dim=0))

    def prior(self, normal: Tensor) -> Tensor:
        """ζ [..., Z] from standard normal numbers [..., Z]: F⁻¹(Φ(x)), linear between quantiles."""
        position = torch.special.ndtr(normal.double()).float() * (QUANTILES - 1)
        below = position.long().clamp(max=QUANTILES - 2)
        component = torch.arange(normal.shape[-1], device=normal.device)
        low, high = self.quantiles[below, component], self.quantiles[below + 1, component]
        return torch.lerp(low, high, position - below)
