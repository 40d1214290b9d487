"""An ensemble of residual VAEs: epistemic uncertainty of the CVAE, future work in section V."""

import torch
from torch import Tensor

from study.data.normalization import Normalization
from study.models.base import models
from study.models.full_vae_ensemble import VaeEnsembleSettings
from study.models.model_ensemble import EnsembleOfModels, Rows
from study.models.residual_vae import ResidualVae
from study.models.rnn_ensemble import RnnEnsemble


@models.register("residual_vae_ensemble")
class ResidualVaeEnsemble(EnsembleOfModels[VaeEnsembleSettings, ResidualVae]):
    """ŷ_pred = ε̂_alea,j + ŷ_m: J residual VAEs on one ensemble of M recurrent networks.

    Each sample has one pair (m, j) over the whole horizon. The pair is sampled as one number
    p ~ U{0 … M·J−1}, with m = p mod M and j = ⌊p / M⌋.

    Args:
        normalization, settings: see `EnsembleOfModels`.
        beta: β of equation (12), the same for all residual VAEs.
        ensemble: the fitted ensemble, saved with the weights and not trained further.
    """

    settings_class = VaeEnsembleSettings
    member_class = ResidualVae
    tunes_beta = uses_ensemble = True

    def __init__(
        self,
        normalization: Normalization,
        settings: VaeEnsembleSettings,
        beta: float,
        ensemble: RnnEnsemble,
    ) -> None:
        # The residual VAEs have no ensemble, so that the file holds the ensemble's weights once.
        count = settings.model_ensemble.members
        members = [ResidualVae(normalization, settings, beta, None) for _ in range(count)]
        super().__init__(normalization, settings, members)
        self.ensemble = ensemble.requires_grad_(False)

    def members_count(self) -> int:
        """M·J."""
        return len(self.members) * self.ensemble.members_count()

    def forward(self, s0: Tensor, actions: Tensor) -> Tensor:
        """ŷ_m of the recurrent networks [S, M, T, D], in normalised units.

        Args:
            s0: [S, D].
            actions: [S, T, A].
        """
        return self.ensemble(s0, actions)

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """See `Model.sample`; the recurrent networks forecast each scenario once."""
        count = self.ensemble.members_count()
        recurrent, forecasts = member % count, self.ensemble(s0, actions)

        def forecast(vae: ResidualVae, rows: Rows) -> Tensor:
            scenario, _ = rows
            # The baseline of a sample is ŷ_m of its own m, like that of an ensemble of one member.
            members = forecasts[scenario, recurrent[rows]][:, None]
            index = torch.zeros_like(scenario)[:, None]
            inputs = (s0[scenario], actions[scenario], noise[rows][:, None])
            return vae.generate(*inputs, index, members)[:, 0]

        return self.gather(member // count, noise, forecast)
