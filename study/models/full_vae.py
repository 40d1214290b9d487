"""The full VAE: the recurrent CVAE on the state itself (section III-C; Acharya et al. 2022)."""

import torch
from torch import Tensor

from study.models.forecaster import models
from study.models.vae import Vae


@models.register("full_vae")
class FullVae(Vae):
    """Same network as the residual VAE, with nothing to add to: the baseline is zero."""

    def conditions(
        self, s0: Tensor, actions: Tensor, member: Tensor, members: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """See `Vae.conditions`: b = 0; the decoder sees the actions."""
        batch, horizon, _ = actions.shape
        return torch.zeros(batch, horizon + 1, self.state_size, device=s0.device), actions
