"""The residual VAE: the recurrent CVAE on the residual to a sampled member (section III-B)."""

from typing import Any

from study.data.normalization import Normalization
from study.models.base import models
from study.models.baseline import OnMembers
from study.models.rnn_ensemble import Ensemble
from study.models.vae import Vae


@models.register("residual_vae")
class ResidualVae(OnMembers, Vae):
    """ŝ_pred = ε̂_alea + ŷ_m, with m drawn uniformly and kept over the horizon.

    Args:
        normalization, settings, beta: see `Vae`.
        ensemble: the fitted ensemble. It is kept with the weights, and not trained further.
    """

    version = 4

    def __init__(
        self,
        normalization: Normalization,
        settings: dict[str, Any],
        beta: float,
        ensemble: Ensemble,
    ) -> None:
        super().__init__(normalization, settings, beta, len(normalization.state_mean))
        self.ensemble = ensemble.requires_grad_(False)
