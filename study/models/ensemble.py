"""The deep ensemble of recurrent networks: the epistemic part (section III-A, equation 9)."""

from typing import Any

import torch
from torch import Tensor, nn

from study.data.scaling import Scaling
from study.models.forecaster import Model, adam


class Member(nn.Module):
    """One recurrent network for p_θ(s_{1:T} | s_0; a_{0:T-1}).

    Its state begins as a function of s_0 and is driven by the actions; no forecast state is fed
    back. The output is the change since s_0, so that a new network forecasts that nothing moves.
    """

    def __init__(self, state_size: int, action_size: int, hidden_size: int) -> None:
        super().__init__()
        self.start = nn.Sequential(nn.Linear(state_size, hidden_size), nn.Tanh())
        self.recurrence = nn.GRU(action_size + state_size, hidden_size, batch_first=True)
        self.head = nn.Sequential(
            nn.Linear(hidden_size, hidden_size), nn.SiLU(), nn.Linear(hidden_size, state_size)
        )

    def forward(self, s0: Tensor, actions: Tensor) -> Tensor:
        """ŝ_{1:T} [B, T, D] from s_0 [B, D] and a_{0:T-1} [B, T, A], in standard units."""
        begun = s0[:, None].expand(-1, actions.shape[1], -1)
        hidden, _ = self.recurrence(torch.cat([actions, begun], -1), self.start(s0)[None])
        change: Tensor = self.head(hidden)
        return s0[:, None] + change


class Ensemble(Model):
    """M members, fitted side by side; they differ by initialisation and by the order of the data.

    As a forecaster it is the reference "ensemble alone": each sample is one member's forecast,
    m ~ U{0 … M−1}.
    """

    sections = ("ensemble",)
    noise_size = 0

    def __init__(self, scaling: Scaling, settings: dict[str, Any]) -> None:
        super().__init__(scaling, settings)
        ensemble = settings["ensemble"]
        self.members = nn.ModuleList(
            Member(self.state_size, self.action_size, ensemble["hidden_size"])
            for _ in range(ensemble["members"])
        )

    def members_count(self) -> int:
        """M."""
        return len(self.members)

    def forward(self, s0: Tensor, actions: Tensor) -> Tensor:
        """ŷ_m of all members: [B, M, T, D] from s_0 [B, D], a_{0:T-1} [B, T, A]."""
        return torch.stack([member(s0, actions) for member in self.members], dim=1)

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """See `Model.sample`: row r is the forecast of member[r]."""
        forecasts = torch.empty(*actions.shape[:2], self.state_size, device=s0.device)
        for index, network in enumerate(self.members):
            rows = member == index
            if rows.any():
                forecasts[rows] = network(s0[rows], actions[rows])
        return forecasts

    def training_step(self, batch: dict[str, Tensor]) -> Tensor:
        """−log p_θ of each member under a Gaussian of fixed scale: the squared error.

        The batch has a leading axis M: each member sees the data in its own order.
        """
        states, actions = batch["states"], batch["actions"]
        errors = torch.stack(
            [
                (member(s[:, 0], a) - s[:, 1:]).square().mean()
                for member, s, a in zip(self.members, states, actions, strict=True)
            ]
        )
        for index, error in enumerate(errors.detach()):
            self.log(f"loss/member_{index}", error)
        # The members share no parameter, so the sum's gradient is each member's own.
        return errors.sum()

    def validation_step(self, batch: dict[str, Tensor]) -> None:
        """Squared error on trajectories not trained on, averaged over the members."""
        forecasts = self(*self.standard(batch["s0"], batch["actions"]))[:, :, None]
        truth = (batch["observed"] - self.state_mean) / self.state_scale
        errors = (forecasts - truth[:, None]).square().mean((0, 2, 3, 4))
        for index, error in enumerate(errors):
            self.log(f"validation/member_{index}", error, batch_size=len(forecasts))
        self.log("validation_score", errors.mean(), batch_size=len(forecasts))

    def configure_optimizers(self) -> Any:
        """See `adam`."""
        ensemble = self.settings["ensemble"]
        return adam(self.parameters(), ensemble["learning_rate"], ensemble["steps"])
