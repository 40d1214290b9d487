"""The full VAE: the recurrent CVAE on the state itself (section III-C; Acharya et al. 2022)."""

from study.models.base import models
from study.models.baseline import ZeroBaseline
from study.models.vae import VaeModel, VaeSettings


@models.register("full_vae")
class FullVae(ZeroBaseline[VaeSettings], VaeModel):
    """The network of the residual VAE with a baseline of zero.

    Args:
        normalization, settings, beta: see `VaeModel`.
    """
