"""The full VAE: the recurrent CVAE on the state itself (section III-C; Acharya et al. 2022)."""

from typing import Any

from torch import Tensor

from study.data.scaling import Scaling
from study.models.baseline import of_nothing
from study.models.forecaster import models
from study.models.vae import Vae


@models.register("full_vae")
class FullVae(Vae):
    """Same network as the residual VAE, with nothing to add to: the baseline is zero.

    Args:
        scaling, settings, beta: see `Vae`.
    """

    def __init__(self, scaling: Scaling, settings: dict[str, Any], beta: float) -> None:
        vae = settings["vae"]
        super().__init__(scaling, settings, beta, vae["full_output"], vae["full_feeding"])

    def conditions(
        self, s0: Tensor, actions: Tensor, member: Tensor, members: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """See `Vae.conditions`: b = 0."""
        return of_nothing(s0, actions, member.shape[1])
