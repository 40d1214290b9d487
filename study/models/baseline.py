"""The baseline b_{0:T} to which a decoder adds its output, and the condition of the decoder."""

from abc import abstractmethod

import torch
from torch import Tensor

from study.models.base import Model, S
from study.models.rnn_ensemble import RnnEnsemble
from study.models.sampling import repeat_samples


class BaselineModel(Model[S]):
    """A model whose decoder adds its output to a baseline (`MemberBaseline`, `ZeroBaseline`)."""

    @abstractmethod
    def condition_size(self) -> int:
        """C, the size of the decoder's condition."""

    @abstractmethod
    def baselines(self, s0: Tensor, actions: Tensor, members: Tensor | None) -> Tensor:
        """b_{0:T} of all members [S, M, T+1, D].

        Args:
            s0: [S, D].
            actions: [S, T, A].
            members: ŷ_m [S, M, T, D], the ensemble's forecasts; None to compute them.
        """

    @abstractmethod
    def condition(self, baseline: Tensor, actions: Tensor) -> Tensor:
        """The decoder's condition c_{0:T-1} [B, T, C].

        Args:
            baseline: b_{0:T} [B, T+1, D].
            actions: [B, T, A].
        """

    def select(self, baselines: Tensor, actions: Tensor, member: Tensor) -> tuple[Tensor, Tensor]:
        """The baseline b_{0:T} [S·K, T+1, D] and the condition [S·K, T, C] of each sample.

        Args:
            baselines: of all members [S, M, T+1, D].
            actions: [S, T, A].
            member: m [S, K].
        """
        scenarios = torch.arange(len(member), device=member.device)[:, None]
        baseline = baselines[scenarios, member].flatten(0, 1)
        return baseline, self.condition(baseline, repeat_samples(actions, member.shape[1]))


class MemberBaseline(BaselineModel[S]):
    """b = ŷ_m, the forecast of a member of the fitted ensemble, which is not trained further.

    A member of an ensemble of models has no `RnnEnsemble`. Its baselines need the forecasts ŷ_m.
    """

    uses_ensemble = True
    ensemble: RnnEnsemble | None

    def members_count(self) -> int:
        """M; 1 without an ensemble."""
        return 1 if self.ensemble is None else self.ensemble.members_count()

    def condition_size(self) -> int:
        """See `BaselineModel.condition_size`."""
        return self.action_size + 2 * self.state_size

    def baselines(self, s0: Tensor, actions: Tensor, members: Tensor | None) -> Tensor:
        """See `BaselineModel.baselines`: b_0 = s_0 and b_{1:T} = ŷ_m.

        Raises:
            ValueError: there is neither an ensemble nor its forecasts.
        """
        if members is None:
            if self.ensemble is None:
                raise ValueError("a model without an ensemble needs the members' forecasts")
            with torch.no_grad():
                members = self.ensemble(s0, actions)
        start = s0[:, None, None].expand(-1, members.shape[1], -1, -1)
        return torch.cat([start, members], dim=2)

    def condition(self, baseline: Tensor, actions: Tensor) -> Tensor:
        """See `BaselineModel.condition`: c_t = [a_t, ŝ^m_{t+1}] (Figure 2, right), and its change.

        The decoder adds its output to the baseline's change, and has to cancel a wrong change. The
        change is in units of δ, since it is hundreds of times smaller than the state.
        """
        return torch.cat([actions, baseline[:, 1:], baseline.diff(dim=1) / self.delta_std], dim=-1)


class ZeroBaseline(BaselineModel[S]):
    """b = 0: the decoder generates the state itself."""

    def condition_size(self) -> int:
        """See `BaselineModel.condition_size`."""
        return self.action_size

    def baselines(self, s0: Tensor, actions: Tensor, members: Tensor | None) -> Tensor:
        """See `BaselineModel.baselines`: b = 0, of one member."""
        return s0.new_zeros(len(s0), 1, actions.shape[1] + 1, s0.shape[-1])

    def condition(self, baseline: Tensor, actions: Tensor) -> Tensor:
        """See `BaselineModel.condition`: c_t = a_t."""
        return actions
