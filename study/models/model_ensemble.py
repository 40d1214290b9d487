"""Ensembles of complete models: members disagree where the data do not determine the model.

M complete models of one class have different initial weights and different orders of the data.
They are treated as M samples from the distribution of models that fit the data (Lakshminarayanan
et al., NeurIPS 2017). Each forecast is sampled from one member for the whole horizon:

    p(s_{1:T} | s_0; a_{0:T-1}) = 1/M Σ_m p_m(s_{1:T} | s_0; a_{0:T-1})

The variance of one member's forecast is aleatoric. The variance between the members' means is
epistemic.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Generic, TypeVar, cast

import torch
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from study.config.model_sections import ModelEnsemble
from study.config.settings import Train
from study.data.normalization import Normalization
from study.models.base import Model

Rows = tuple[Tensor, Tensor]
"""Indices of forecasts: scenario [R] and sample [R]."""


@dataclass(frozen=True)
class EnsembleOfModelsSettings:
    """Settings of an ensemble; a subclass adds those of a member."""

    model_ensemble: ModelEnsemble
    train: Train


E = TypeVar("E", bound=EnsembleOfModelsSettings)
M = TypeVar("M", bound=Model[Any])


class EnsembleOfModels(Model[E], Generic[E, M]):
    """M members of the class `member_class`, trained in parallel.

    Args:
        normalization: see `Model`.
        settings: those of the ensemble, and of a member.
        members: new models of the class `member_class`.
    """

    member_class: ClassVar[type[Model[Any]]]

    def __init__(self, normalization: Normalization, settings: E, members: Iterable[M]) -> None:
        super().__init__(normalization, settings)
        self.members = nn.ModuleList(members)
        self.data_streams = len(self.members)
        self.noise_size = self.member_models()[0].noise_size

    def member_models(self) -> list[M]:
        """The members, with their type."""
        return cast("list[M]", list(self.members))

    def members_count(self) -> int:
        """M."""
        return len(self.members)

    @classmethod
    def training_options(cls, settings: E) -> Train:
        """See `Model.training_options`: those of a member."""
        return cls.member_class.training_options(settings)

    @classmethod
    def trial_settings(cls, settings: E) -> E:
        """See `Model.trial_settings`: one member, since β is the same for all members."""
        return replace(settings, model_ensemble=replace(settings.model_ensemble, members=1))

    def on_training_data(self, states: Tensor) -> None:
        """See `Model.on_training_data`."""
        super().on_training_data(states)
        for member in self.member_models():
            member.on_training_data(states)

    def resets_optimizer_at(self, step: int) -> bool:
        """See `Model.resets_optimizer_at`: at the same steps as a member."""
        return self.member_models()[0].resets_optimizer_at(step)

    def schedule(self, optimizer: Optimizer, learning_rate: float, steps: int) -> LRScheduler:
        """See `Model.schedule`: that of a member."""
        return self.member_models()[0].schedule(optimizer, learning_rate, steps)

    def losses(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """The sum of the members' losses, on a batch with a leading axis M.

        Members share no parameter, so the gradient of the sum is the gradient of each member.
        """
        by_member = [
            member.losses({name: values[index] for name, values in batch.items()}, step)
            for index, member in enumerate(self.member_models())
        ]
        stacked = {
            name: torch.stack([losses[name] for losses in by_member]) for name in by_member[0]
        }
        curves = {f"loss/member_{m}": loss for m, loss in enumerate(stacked["loss"])}
        means = {name: values.mean() for name, values in stacked.items() if name != "loss"}
        return {"loss": stacked["loss"].sum()} | curves | means

    def diagnostics(self, batch: dict[str, Tensor]) -> dict[str, float]:
        """See `Model.diagnostics`: the mean over the members."""
        by_member = [member.diagnostics(batch) for member in self.member_models()]
        return {
            name: sum(values[name] for values in by_member) / len(by_member)
            for name in by_member[0]
        }

    def negative_elbo(self, batch: dict[str, Tensor]) -> float:
        """See `Model.negative_elbo`: the mean over the members.

        It is at least that of the mixture of the members (Jensen's inequality).
        """
        values = [member.negative_elbo(batch) for member in self.member_models()]
        return sum(values) / len(values)

    def configure_gradient_clipping(
        self,
        optimizer: Any,
        gradient_clip_val: float | None = None,
        gradient_clip_algorithm: str | None = None,
    ) -> None:
        """Lightning's hook: clip each member's gradient by its own norm, as in separate training.

        With one norm for all members, a large gradient of one member would shrink those of all.
        """
        for member in self.members:
            trained = [p for p in member.parameters() if p.requires_grad]
            if gradient_clip_val:
                nn.utils.clip_grad_norm_(trained, gradient_clip_val)

    def forward(self, s0: Tensor, actions: Tensor) -> Tensor:
        """Each member's forecast with noise 0, [S, M, T, D], in normalised units.

        Args:
            s0: [S, D].
            actions: [S, T, A].
        """
        size = self.member_models()[0].noise_size
        noise = s0.new_zeros(len(s0), len(self.members), actions.shape[1], size)
        every_member = torch.arange(len(self.members), device=s0.device).expand(len(s0), -1)
        return EnsembleOfModels.sample(self, s0, actions, noise, every_member)

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """See `Model.sample`: sample k of a scenario is a sample of member[k]."""

        def forecast(model: M, rows: Rows) -> Tensor:
            scenario, _ = rows
            index = torch.zeros_like(scenario)[:, None]
            inputs = (s0[scenario], actions[scenario], noise[rows][:, None])
            return model.sample(*inputs, index)[:, 0]

        return self.gather(member, noise, forecast)

    def gather(
        self, member: Tensor, noise: Tensor, forecast: Callable[[M, Rows], Tensor]
    ) -> Tensor:
        """Forecasts [S, K, T, D], computed together for all samples of one member.

        Args:
            member: [S, K], the member of each sample.
            noise: [S, K, T, `noise_size`].
            forecast: returns the forecasts [R, T, D] of a member for its rows [R].
        """
        forecasts = noise.new_empty(*noise.shape[:3], self.state_size)
        for index, model in enumerate(self.member_models()):
            rows = torch.nonzero(member == index, as_tuple=True)
            if len(rows[0]):
                forecasts[rows] = forecast(model, (rows[0], rows[1]))
        return forecasts
