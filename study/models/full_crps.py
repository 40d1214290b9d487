"""The full CRPS model: a decoder trained with proper scores generates the state itself."""

from study.models.base import models
from study.models.baseline import ZeroBaseline
from study.models.crps import CrpsModel, CrpsSettings


@models.register("full_crps")
class FullCrps(ZeroBaseline[CrpsSettings], CrpsModel):
    """The network of `ResidualCrps` with a baseline of zero: an ablation of the residual."""
