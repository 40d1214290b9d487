"""Ensembles of whole models: the members disagree where the data do not say.

M complete members of one class, each with weights and an order of the data of its own, are taken
as M draws from what the model could be, given the data (Lakshminarayanan et al., NeurIPS 2017). A
sample of the forecast is a sample of one member, kept over the horizon:

    p(s_{1:T} | s_0; a_{0:T-1}) = 1/M Σ_m p_m(s_{1:T} | s_0; a_{0:T-1})

What a member foresees by itself is aleatoric, the variance between the members' means epistemic.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from study.data.normalization import Normalization
from study.models.base import Model

Rows = tuple[Tensor, Tensor]
"""Which forecasts [R], each by its scenario and its sample."""


class EnsembleOf(Model):
    """M members of `member_class`, trained side by side; a subclass says of which class.

    Args:
        normalization: standard units.
        settings: the section `model_ensemble` of the configuration, and those of a member.
        given: what else a member is given.
    """

    member_class: ClassVar[type[Model]]

    def __init__(
        self, normalization: Normalization, settings: dict[str, Any], **given: Any
    ) -> None:
        super().__init__(normalization, settings)
        self.orders = int(settings["model_ensemble"]["members"])
        self.members = nn.ModuleList(
            self.member_class(normalization, settings, **given) for _ in range(self.orders)
        )
        self.noise_size = self.each()[0].noise_size

    def each(self) -> list[Any]:
        """The members, of class `member_class`."""
        return list(self.members)

    def members_count(self) -> int:
        """M."""
        return len(self.members)

    @classmethod
    def trial_settings(cls, settings: dict[str, Any]) -> dict[str, Any]:
        """One member: they all share β, which is searched for as that of one model."""
        return settings | {"model_ensemble": settings["model_ensemble"] | {"members": 1}}

    @classmethod
    def budget(cls, settings: dict[str, Any]) -> dict[str, Any]:
        """See `Model.budget`: that of a member."""
        return cls.member_class.budget(settings)

    def see(self, states: Tensor) -> None:
        """See `Model.see`."""
        for member in self.each():
            member.see(states)

    def schedule(self, optimizer: Optimizer, learning_rate: float, steps: int) -> LRScheduler:
        """See `Model.schedule`: that of a member."""
        schedule: LRScheduler = self.each()[0].schedule(optimizer, learning_rate, steps)
        return schedule

    def forgets(self, step: int) -> bool:
        """See `Model.forgets`: as a member."""
        forgets: bool = self.each()[0].forgets(step)
        return forgets

    def losses(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """The sum of the members' losses, each on its own batch: the batch has a leading axis M.

        The members share no parameter, so the sum's gradient is each member's own.
        """
        told = [
            member.losses({name: values[index] for name, values in batch.items()}, step)
            for index, member in enumerate(self.each())
        ]
        parts = {name: torch.stack([values[name] for values in told]) for name in told[0]}
        of_members = {f"loss/member_{m}": loss for m, loss in enumerate(parts["loss"])}
        means = {name: values.mean() for name, values in parts.items() if name != "loss"}
        return {"loss": parts["loss"].sum()} | of_members | means

    def configure_gradient_clipping(
        self,
        optimizer: Any,
        gradient_clip_val: float | None = None,
        gradient_clip_algorithm: str | None = None,
    ) -> None:
        """Each member's gradient is clipped by its own norm, as if it were trained alone.

        By the norm of all together, a member with a large gradient would slow the others down.
        """
        for member in self.members:
            wanted = [p for p in member.parameters() if p.requires_grad]
            if gradient_clip_val:
                nn.utils.clip_grad_norm_(wanted, gradient_clip_val)

    def forward(self, s0: Tensor, actions: Tensor) -> Tensor:
        """Each member's forecast without noise [S, M, T, D], from s_0 [S, D], a [S, T, A]."""
        size = self.each()[0].noise_size
        noise = s0.new_zeros(len(s0), len(self.members), actions.shape[1], size)
        everyone = torch.arange(len(self.members), device=s0.device).expand(len(s0), -1)
        return EnsembleOf.sample(self, s0, actions, noise, everyone)

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """See `Model.sample`: sample k of a scenario is one of member[k], with the same noise."""

        def forecast(network: Model, rows: Rows) -> Tensor:
            scenario, _ = rows
            given, none = (s0[scenario], actions[scenario]), torch.zeros_like(scenario)
            return network.sample(*given, noise[rows][:, None], none[:, None])[:, 0]

        return self.gather(member, noise, forecast)

    def gather(
        self, member: Tensor, noise: Tensor, forecast: Callable[[Any, Rows], Tensor]
    ) -> Tensor:
        """Forecasts [S, K, T, D], all of one member together.

        Args:
            member: [S, K], the member of each.
            noise: [S, K, T, ·].
            forecast: a member and the rows [R] that it forecasts to [R, T, D].
        """
        forecasts = noise.new_empty(*noise.shape[:3], self.state_size)
        for index, network in enumerate(self.members):
            rows = torch.nonzero(member == index, as_tuple=True)
            if len(rows[0]):
                forecasts[rows] = forecast(network, (rows[0], rows[1]))
        return forecasts
