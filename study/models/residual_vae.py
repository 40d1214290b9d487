"""The residual VAE: the recurrent CVAE on the residual to a sampled member (section III-B)."""

from study.data.normalization import Normalization
from study.models.base import models
from study.models.baseline import MemberBaseline
from study.models.rnn_ensemble import RnnEnsemble
from study.models.vae import VaeModel, VaeSettings


@models.register("residual_vae")
class ResidualVae(MemberBaseline[VaeSettings], VaeModel):
    """ŷ_pred = ε̂_alea + ŷ_m, with one m ~ U{0 … M−1} for the whole horizon.

    Args:
        normalization, settings, beta: see `VaeModel`.
        ensemble: the fitted ensemble, saved with the weights and not trained further; see
            `MemberBaseline`.
    """

    def __init__(
        self,
        normalization: Normalization,
        settings: VaeSettings,
        beta: float,
        ensemble: RnnEnsemble | None,
    ) -> None:
        super().__init__(normalization, settings, beta)
        self.ensemble = None if ensemble is None else ensemble.requires_grad_(False)
