"""An ensemble of full VAEs: the rival that the residual VAE's authors come from.

Acharya, Russell and Ahmed, "Uncertainty aware forecasting with ensembles of deep generative
models" (workshop paper, 2022; the full VAE's source as well): each member is a generative model of
the state, p_m(s_{1:T} | s_0; a_{0:T-1}), and the members' disagreement is the epistemic part.
"""

from typing import Any

from study.data.normalization import Normalization
from study.models.base import models
from study.models.full_vae import FullVae
from study.models.model_ensemble import EnsembleOf


@models.register("full_vae_ensemble")
class FullVaeEnsemble(EnsembleOf):
    """m ~ U{0 … M−1} for each sample, then z_{1:T} ~ p(z), then ŝ_{1:T} by the decoder of m.

    Args:
        normalization, settings: see `EnsembleOf`.
        beta: β of equation (12), of all members.
    """

    member_class = FullVae
    version = FullVae.version
    tunes_beta = True
    sections = ("model_ensemble", *FullVae.sections)

    def __init__(self, normalization: Normalization, settings: dict[str, Any], beta: float) -> None:
        super().__init__(normalization, settings, beta=beta)
