"""The deep ensemble of recurrent networks: epistemic uncertainty (section III-A, equation 10)."""

from dataclasses import dataclass, field

import torch
from torch import Tensor

from study.config.model_sections import Network
from study.config.settings import Ensemble, Train
from study.data.normalization import Normalization
from study.models.base import Model
from study.models.networks.architecture import Architecture
from study.models.networks.dynamics import DynamicsNetwork
from study.models.networks.likelihood import optimal_variance_nll


@dataclass(frozen=True)
class RnnEnsembleSettings:
    """Settings of the ensemble."""

    ensemble: Ensemble
    network: Network = field(default_factory=Network)

    @property
    def train(self) -> Train:
        """The training options of the section `ensemble`."""
        options = self.ensemble
        return Train(
            steps=options.steps,
            batch_size=options.batch_size,
            learning_rate=options.learning_rate,
            weight_decay=options.weight_decay,
            symmetries=options.symmetries,
            validate_every=options.validate_every,
            patience=options.patience,
        )


class RnnEnsemble(Model[RnnEnsembleSettings]):
    """M recurrent networks that differ by initial weights and by the order of their data.

    As a forecaster it is the reference "ensemble alone": each sample is the forecast of one
    member, m ~ U{0 … M−1}.
    """

    settings_class = RnnEnsembleSettings
    noise_size = 0

    def __init__(self, normalization: Normalization, settings: RnnEnsembleSettings) -> None:
        super().__init__(normalization, settings)
        count, hidden_size = settings.ensemble.members, settings.ensemble.hidden_size
        self.data_streams = count
        architecture = Architecture(
            inputs=self.action_size,
            width=hidden_size,
            memory=True,
            product=settings.network.features == "product",
            networks=count,
        )
        self.members = DynamicsNetwork(normalization, architecture)

    def members_count(self) -> int:
        """M."""
        return self.settings.ensemble.members

    def forward(self, s0: Tensor, actions: Tensor) -> Tensor:
        """ŷ_m of all members [B, M, T, D], in normalised units.

        Args:
            s0: [B, D].
            actions: a_{0:T-1} [B, T, A].
        """
        count = self.members_count()
        s0, actions = s0.expand(count, *s0.shape), actions.expand(count, *actions.shape)
        return torch.movedim(self.rollout(s0, actions), 0, 1)

    def rollout(self, s0: Tensor, actions: Tensor) -> Tensor:
        """ŷ_m [M, B, T, D] from s_0 [M, B, D] and actions [M, B, T, A] of each member."""
        hidden = self.members.start(s0, s0[..., :0])
        offset = s0.new_zeros(*actions.shape[:-1], self.state_size)
        return self.members.rollout(s0, actions, offset, hidden)[0]

    def on_training_data(self, states: Tensor) -> None:
        """See `Model.on_training_data`: the members store the range of the training states."""
        super().on_training_data(states)
        self.members.set_range(states)

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """See `Model.sample`: sample k of a scenario is the forecast of member[k]."""
        scenarios = torch.arange(len(s0), device=s0.device)[:, None]
        return self(s0, actions)[scenarios, member]

    def training_step(self, batch: dict[str, Tensor]) -> Tensor:
        """The sum of the members' losses. The training curves have each of them."""
        losses = self.member_losses(batch, self.global_step)
        self.log_curves({f"loss/member_{index}": loss for index, loss in enumerate(losses)})
        # Members share no parameter: the gradient of the sum is each member's own gradient.
        return losses.sum()

    def losses(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """See `Model.losses`: the sum over the members."""
        return {"loss": self.member_losses(batch, step).sum()}

    def member_losses(self, batch: dict[str, Tensor], step: int) -> Tensor:
        """−log p_θ of each member (equation 10) [M], averaged over trajectories, t and dimensions.

        The batch has a leading axis M: each member has its own order of the data. The first steps
        are teacher forced, since the network then learns quickly. The later steps train on
        autoregressive rollouts.
        """
        states, actions, options = batch["states"], batch["actions"], self.settings.ensemble
        s0, truth = states[:, :, 0], states[:, :, 1:]
        teacher_forced = step < options.teacher_forcing_fraction * options.steps
        if teacher_forced:
            hidden = self.members.start(s0, s0[..., :0])
            offset = torch.zeros_like(truth)
            forecasts, _ = self.members.mean(states[:, :, :-1], actions, offset, hidden)
        else:
            forecasts = self.rollout(s0, actions)
        return optimal_variance_nll((forecasts - truth).square().mean((1, 2))).mean(-1)

    def validation_step(self, batch: dict[str, Tensor]) -> None:
        """Log −log p_θ of autoregressive rollouts of the validation scenarios, by member."""
        forecasts = self(*self.normalize(batch["s0"], batch["actions"]))[:, :, None]
        truth = self.normalize_states(batch["observed"])
        squared_error = (forecasts - truth[:, None]).square().mean((0, 2, 3))
        losses = optimal_variance_nll(squared_error).mean(-1)
        for index, loss in enumerate(losses):
            self.log(f"validation/member_{index}", loss, batch_size=len(forecasts))
        self.log("validation_score", losses.mean(), batch_size=len(forecasts))
