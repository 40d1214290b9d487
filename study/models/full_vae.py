"""The full VAE: the recurrent CVAE on the state itself (section III-C; Acharya et al. 2022)."""

from study.models.base import models
from study.models.baseline import OnNothing
from study.models.vae import Vae


@models.register("full_vae")
class FullVae(OnNothing, Vae):
    """Same network as the residual VAE, with nothing to add to: the baseline is zero.

    Args:
        normalization, settings, beta: see `Vae`.
    """

    version = 3
