"""An ensemble of full VAEs, the earlier method of the residual VAE's authors.

Acharya, Russell and Ahmed, "Uncertainty quantification for competency assessment of autonomous
agents" (ICRA workshop, 2022, arXiv:2206.10553): each member is a generative model of the state,
p_m(s_{1:T} | s_0; a_{0:T-1}).
"""

from dataclasses import dataclass

from study.data.normalization import Normalization
from study.models.base import models
from study.models.full_vae import FullVae
from study.models.model_ensemble import EnsembleOfModels, EnsembleOfModelsSettings
from study.models.vae import VaeSettings


@dataclass(frozen=True)
class VaeEnsembleSettings(VaeSettings, EnsembleOfModelsSettings):
    """Settings of an ensemble of VAEs."""


@models.register("full_vae_ensemble")
class FullVaeEnsemble(EnsembleOfModels[VaeEnsembleSettings, FullVae]):
    """m ~ U{0 … M−1} for each sample, then z_{1:T} ~ p(z), then ŝ_{1:T} by the decoder of m.

    Args:
        normalization, settings: see `EnsembleOfModels`.
        beta: β of equation (12), the same for all members.
    """

    settings_class = VaeEnsembleSettings
    member_class = FullVae
    tunes_beta = True

    def __init__(
        self, normalization: Normalization, settings: VaeEnsembleSettings, beta: float
    ) -> None:
        count = settings.model_ensemble.members
        members = [FullVae(normalization, settings, beta) for _ in range(count)]
        super().__init__(normalization, settings, members)
