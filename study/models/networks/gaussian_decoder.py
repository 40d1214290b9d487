"""The VAEs' decoder: a normal distribution of the next state whose width depends on the past."""

import torch
from torch import Tensor, nn

from study.models.networks.decoder import RecurrentDecoder


class GaussianDecoder(RecurrentDecoder):
    """p_θ(s_{t+1} | ·) = N(ŝ_{t+1}, σ² exp(2 w_{t+1})), w_{t+1} = tanh(W h_{t+1} + c).

    σ is one number for each dimension, the scale of all errors in training. w says how much wider
    or narrower the distribution is here and now: wind makes a flight less certain, a ball at rest
    stays where it is. It is bounded, so that noise that is fed back cannot widen without end.

    Args:
        output_scale, condition_size, hidden_size, latent_size, increments: see `RecurrentDecoder`.
        one_width: w = 0, always.
    """

    variance: Tensor
    """σ² [D]: a running mean over batches, see `remember`."""

    def __init__(
        self,
        output_scale: Tensor,
        condition_size: int,
        hidden_size: int,
        latent_size: int,
        increments: bool = False,
        one_width: bool = False,
    ) -> None:
        super().__init__(output_scale, condition_size, hidden_size, latent_size, increments)
        self.register_buffer("variance", torch.ones_like(output_scale))
        self.width = nn.Linear(hidden_size, len(output_scale))
        nn.init.zeros_(self.width.weight)
        nn.init.zeros_(self.width.bias)
        self.width.requires_grad_(not one_width)

    def distribution(
        self,
        s0: Tensor,
        baseline: Tensor,
        condition: Tensor,
        latent: Tensor,
        truth: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """ŝ_{1:T} and w_{1:T}, [B, T, D] each. Arguments as of `RecurrentDecoder.forward`."""
        hiddens, mean = self.unroll(s0, baseline, condition, latent, truth, hiddens=True)
        return mean, torch.tanh(self.width(hiddens))

    @torch.no_grad()
    def draw(
        self, s0: Tensor, baseline: Tensor, condition: Tensor, latent: Tensor, normal: Tensor
    ) -> Tensor:
        """s_{1:T} [B, T, D], each drawn from p_θ and fed back; normal: [B, T, D], standard."""
        spread = torch.cat([self.width.weight.T, self.width.bias[None]])
        noise = normal * self.variance.sqrt()
        return self.unroll(s0, baseline, condition, latent, spread=spread, noise=noise)[1]

    def remember(self, variance: Tensor, share: float) -> None:
        """Take a batch's σ² [D] into the running mean, by the share given; 1 forgets the rest.

        The loss has σ at its best for each batch; forecasts need the one of all data.
        """
        self.variance.lerp_(variance, share)
