"""What a decoder adds to, b_{0:T}, and the conditions that it sees at every step."""

from abc import abstractmethod

import torch
from torch import Tensor

from study.models.ensemble import Ensemble
from study.models.forecaster import Model, each_sample


class OnBaseline(Model):
    """A model whose decoder adds to a baseline; `OnMembers` and `OnNothing` say which."""

    @abstractmethod
    def conditions(
        self, s0: Tensor, actions: Tensor, member: Tensor, members: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """The baseline b_{0:T} [S·K, T+1, D] and the decoder's condition [S·K, T, C].

        Args:
            s0: [S, D].
            actions: [S, T, A].
            member: m [S, K].
            members: [S, M, T, D], the ensemble's forecasts where they are at hand.
        """


class OnMembers(OnBaseline):
    """b = ŷ_m, a member of the fitted `ensemble`, which is not trained further."""

    uses_ensemble = True
    ensemble: Ensemble

    def members_count(self) -> int:
        """M."""
        return self.ensemble.members_count()

    def conditions(
        self, s0: Tensor, actions: Tensor, member: Tensor, members: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """See `OnBaseline.conditions`: b = ŷ_m."""
        return of_members(self.ensemble, s0, actions, member, members)


class OnNothing(OnBaseline):
    """b = 0: the decoder gives the state itself."""

    def conditions(
        self, s0: Tensor, actions: Tensor, member: Tensor, members: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """See `OnBaseline.conditions`: b = 0."""
        return of_nothing(s0, actions, member.shape[1])


def of_members(
    ensemble: Ensemble, s0: Tensor, actions: Tensor, member: Tensor, members: Tensor | None
) -> tuple[Tensor, Tensor]:
    """b = ŷ_m; the decoder sees the actions and ŝ^m_{t+1} (Figure 2, right).

    Args:
        ensemble: gives the members' forecasts where they are not at hand.
        s0: [S, D].
        actions: [S, T, A].
        member: m [S, K].
        members: ŷ of all members [S, M, T, D], or None.

    Returns:
        baseline [S·K, T+1, D] and condition [S·K, T, A + D].
    """
    if members is None:
        with torch.no_grad():
            members = ensemble(s0, actions)
    scenarios = torch.arange(len(s0), device=s0.device)[:, None]
    forecast = members[scenarios, member].flatten(0, 1)
    samples = member.shape[1]
    baseline = torch.cat([each_sample(s0, samples)[:, None], forecast], dim=1)
    return baseline, torch.cat([each_sample(actions, samples), forecast], dim=-1)


def of_nothing(s0: Tensor, actions: Tensor, samples: int) -> tuple[Tensor, Tensor]:
    """b = 0 [S·K, T+1, D]; the decoder sees the actions [S·K, T, A]. Arguments as above."""
    condition = each_sample(actions, samples)
    rows, horizon, _ = condition.shape
    return condition.new_zeros(rows, horizon + 1, s0.shape[-1]), condition
