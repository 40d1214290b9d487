"""The residual CRPS model: a decoder trained with proper scores generates the residual."""

from study.data.normalization import Normalization
from study.models.base import models
from study.models.baseline import MemberBaseline
from study.models.crps import CrpsModel, CrpsSettings
from study.models.rnn_ensemble import RnnEnsemble


@models.register("residual_crps")
class ResidualCrps(MemberBaseline[CrpsSettings], CrpsModel):
    """ŷ_pred = ε̂_alea + ŷ_m (section III-B) as in the residual VAE, without the VAE.

    Args:
        normalization, settings: see `Model`.
        ensemble: the fitted ensemble, saved with the weights and not trained further; see
            `MemberBaseline`.
    """

    def __init__(
        self, normalization: Normalization, settings: CrpsSettings, ensemble: RnnEnsemble | None
    ) -> None:
        super().__init__(normalization, settings)
        self.ensemble = None if ensemble is None else ensemble.requires_grad_(False)
