"""The residual VAE: the recurrent CVAE on the residual to a sampled member (section III-B)."""

from typing import Any

import torch
from torch import Tensor

from study.data.scaling import Scaling
from study.models.ensemble import Ensemble
from study.models.forecaster import each_sample, models
from study.models.vae import Vae


@models.register("residual_vae")
class ResidualVae(Vae):
    """ŝ_pred = ε̂_alea + ŷ_m, with m drawn uniformly and kept over the horizon.

    Args:
        scaling, settings, beta: see `Vae`.
        ensemble: the fitted ensemble. It is kept with the weights, and not trained further.
    """

    uses_ensemble = True

    def __init__(
        self, scaling: Scaling, settings: dict[str, Any], beta: float, ensemble: Ensemble
    ) -> None:
        output = settings["vae"]["residual_output"]
        super().__init__(scaling, settings, beta, output, len(scaling.state_mean))
        self.ensemble = ensemble.requires_grad_(False)

    def members_count(self) -> int:
        """M."""
        return self.ensemble.members_count()

    def conditions(
        self, s0: Tensor, actions: Tensor, member: Tensor, members: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """See `Vae.conditions`: b = ŷ_m; the decoder sees the actions and ŝ^m_{t+1} (Figure 2)."""
        if members is None:
            with torch.no_grad():
                members = self.ensemble(s0, actions)
        scenarios = torch.arange(len(s0), device=s0.device)[:, None]
        forecast = members[scenarios, member].flatten(0, 1)
        samples = member.shape[1]
        baseline = torch.cat([each_sample(s0, samples)[:, None], forecast], dim=1)
        return baseline, torch.cat([each_sample(actions, samples), forecast], dim=-1)
