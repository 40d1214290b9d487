"""An ensemble of residual VAEs: the CVAE's own epistemic part, future work in section VI."""

from typing import Any

import torch
from torch import Tensor

from study.data.normalization import Normalization
from study.models.base import models
from study.models.model_ensemble import EnsembleOf, Rows
from study.models.residual_vae import ResidualVae
from study.models.rnn_ensemble import Ensemble


@models.register("residual_vae_ensemble")
class ResidualVaeEnsemble(EnsembleOf):
    """ŝ_pred = ε̂_alea,j + ŷ_m: J residual VAEs on one ensemble of M recurrent networks.

    Each sample draws both m and j and keeps them over the horizon; what is drawn is the pair, a
    number p < M·J with m = p mod M and j = ⌊p / M⌋.

    Args:
        normalization, settings: see `EnsembleOf`.
        beta: β of equation (12), of all residual VAEs.
        ensemble: the fitted ensemble. It is kept with the weights, and not trained further.
    """

    member_class = ResidualVae
    version = ResidualVae.version
    tunes_beta = uses_ensemble = True
    sections = ("model_ensemble", *ResidualVae.sections)

    def __init__(
        self,
        normalization: Normalization,
        settings: dict[str, Any],
        beta: float,
        ensemble: Ensemble,
    ) -> None:
        super().__init__(normalization, settings, beta=beta, ensemble=ensemble)
        self.ensemble = ensemble
        for vae in self.each():
            # It is lent to them: as a module of each, its weights would be in the file J + 1 times.
            del vae.ensemble
            vae.__dict__["ensemble"] = ensemble

    def members_count(self) -> int:
        """M·J."""
        return len(self.members) * self.ensemble.members_count()

    def forward(self, s0: Tensor, actions: Tensor) -> Tensor:
        """ŷ_m of the recurrent networks [S, M, T, D]: p's is that of m = p mod M."""
        return self.ensemble(s0, actions)

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """See `Model.sample`; the recurrent networks forecast each scenario once."""
        count = self.ensemble.members_count()
        recurrent, forecasts = member % count, self.ensemble(s0, actions)

        def forecast(vae: ResidualVae, rows: Rows) -> Tensor:
            scenario, _ = rows
            # The one member drawn, as an ensemble of one.
            own, first = forecasts[scenario, recurrent[rows]], torch.zeros_like(scenario)
            given = s0[scenario], actions[scenario], noise[rows][:, None]
            return vae.generate(*given, first[:, None], own[:, None])[:, 0]

        return self.gather(member // count, noise, forecast)
