"""An ensemble of full CRPS models: several generators, trained side by side."""

from dataclasses import dataclass

from study.data.normalization import Normalization
from study.models.base import models
from study.models.crps import CrpsSettings
from study.models.full_crps import FullCrps
from study.models.model_ensemble import EnsembleOfModels, EnsembleOfModelsSettings


@dataclass(frozen=True)
class CrpsEnsembleSettings(CrpsSettings, EnsembleOfModelsSettings):
    """Settings of an ensemble of CRPS models."""


@models.register("full_crps_ensemble")
class FullCrpsEnsemble(EnsembleOfModels[CrpsEnsembleSettings, FullCrps]):
    """m ~ U{0 … M−1} for each sample, then ζ and z_{1:T}, then ŝ_{1:T} by the generator of m.

    Args:
        normalization, settings: see `EnsembleOfModels`.
    """

    settings_class = CrpsEnsembleSettings
    member_class = FullCrps

    def __init__(self, normalization: Normalization, settings: CrpsEnsembleSettings) -> None:
        count = settings.model_ensemble.members
        members = [FullCrps(normalization, settings) for _ in range(count)]
        super().__init__(normalization, settings, members)
