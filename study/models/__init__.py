"""The forecasters. Importing the module of a model registers it."""

from study.models import (
    full_crps,
    full_crps_ensemble,
    full_vae,
    full_vae_ensemble,
    probabilistic_ensemble,
    probabilistic_mlp,
    residual_crps,
    residual_vae,
    residual_vae_ensemble,
)
from study.models.base import Forecaster, Model, ModelSettings, models

__all__ = [
    "Forecaster",
    "Model",
    "ModelSettings",
    "full_crps",
    "full_crps_ensemble",
    "full_vae",
    "full_vae_ensemble",
    "models",
    "probabilistic_ensemble",
    "probabilistic_mlp",
    "residual_crps",
    "residual_vae",
    "residual_vae_ensemble",
]
