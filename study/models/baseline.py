"""What a decoder adds to, b_{0:T}, and the conditions that it sees at every step."""

from abc import abstractmethod

import torch
from torch import Tensor

from study.models.base import Model, each_sample
from study.models.rnn_ensemble import Ensemble


class OnBaseline(Model):
    """A model whose decoder adds to a baseline; `OnMembers` and `OnNothing` say which."""

    @abstractmethod
    def baselines(self, s0: Tensor, actions: Tensor, members: Tensor | None) -> Tensor:
        """b_{0:T} of every member, [S, M, T+1, D].

        Args:
            s0: [S, D].
            actions: [S, T, A].
            members: [S, M, T, D], the ensemble's forecasts where they are at hand.
        """

    @abstractmethod
    def beside(self, baseline: Tensor, actions: Tensor) -> Tensor:
        """The decoder's condition [B, T, C], from b_{0:T} [B, T+1, D] and the actions."""

    def conditions(
        self, s0: Tensor, actions: Tensor, member: Tensor, members: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """The baseline b_{0:T} [S·K, T+1, D] and the decoder's condition [S·K, T, C].

        Args:
            s0, actions, members: see `baselines`.
            member: m [S, K].
        """
        return self.drawn(self.baselines(s0, actions, members), actions, member)

    def drawn(self, baselines: Tensor, actions: Tensor, member: Tensor) -> tuple[Tensor, Tensor]:
        """`conditions` of the members drawn, from all baselines [S, M, T+1, D]."""
        scenarios = torch.arange(len(member), device=member.device)[:, None]
        baseline = baselines[scenarios, member].flatten(0, 1)
        return baseline, self.beside(baseline, each_sample(actions, member.shape[1]))


class OnMembers(OnBaseline):
    """b = ŷ_m, a member of the fitted `ensemble`, which is not trained further."""

    uses_ensemble = True
    ensemble: Ensemble

    def members_count(self) -> int:
        """M."""
        return self.ensemble.members_count()

    def baselines(self, s0: Tensor, actions: Tensor, members: Tensor | None) -> Tensor:
        """See `OnBaseline.baselines`: b = ŷ_m."""
        if members is None:
            with torch.no_grad():
                members = self.ensemble(s0, actions)
        start = s0[:, None, None].expand(-1, members.shape[1], -1, -1)
        return torch.cat([start, members], dim=2)

    def beside(self, baseline: Tensor, actions: Tensor) -> Tensor:
        """See `OnBaseline.beside`: the actions and ŝ^m_{t+1} (Figure 2, right)."""
        return torch.cat([actions, baseline[:, 1:]], dim=-1)


class OnNothing(OnBaseline):
    """b = 0: the decoder gives the state itself."""

    def baselines(self, s0: Tensor, actions: Tensor, members: Tensor | None) -> Tensor:
        """See `OnBaseline.baselines`: b = 0."""
        return s0.new_zeros(len(s0), 1, actions.shape[1] + 1, s0.shape[-1])

    def beside(self, baseline: Tensor, actions: Tensor) -> Tensor:
        """See `OnBaseline.beside`: the actions."""
        return actions
