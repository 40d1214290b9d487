"""The deep ensemble of recurrent networks: the epistemic part (section III-A, equation 9)."""

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from study.data.scaling import Scaling
from study.models.forecaster import Model, adam
from study.models.recurrence import gru


class StackedLinear(nn.Module):
    """M linear maps side by side: [..., M, B, I] → [..., M, B, O]."""

    def __init__(self, members: int, inputs: int, outputs: int) -> None:
        super().__init__()
        # Each member is initialised as torch.nn.Linear would be, from draws of its own.
        bound = inputs**-0.5
        self.weight = nn.Parameter(torch.empty(members, inputs, outputs).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.zeros(members, 1, outputs))

    def forward(self, values: Tensor) -> Tensor:
        """See the class."""
        return values @ self.weight + self.bias


class Members(nn.Module):
    """M recurrent networks for p_θ(s_{1:T} | s_0; a_{0:T-1}), computed side by side.

    A member's state begins as a function of s_0 and is driven by the actions; no forecast state is
    fed back. The output is the change since s_0, so that a new network forecasts that nothing
    moves.
    """

    def __init__(self, members: int, state_size: int, action_size: int, hidden_size: int) -> None:
        super().__init__()
        self.start = StackedLinear(members, state_size, hidden_size)
        self.driven = StackedLinear(members, action_size + state_size, 3 * hidden_size)
        self.recurrent = StackedLinear(members, hidden_size, 3 * hidden_size)
        self.inner = StackedLinear(members, hidden_size, hidden_size)
        self.outer = StackedLinear(members, hidden_size, state_size)

    def forward(self, s0: Tensor, actions: Tensor) -> Tensor:
        """ŝ_{1:T} [M, B, T, D] from s_0 [M, B, D] and a_{0:T-1} [M, B, T, A], in standard units."""
        steps = torch.movedim(actions, 2, 0)  # time first: [T, M, B, A]
        begun = s0.expand(len(steps), *s0.shape)
        driven = self.driven(torch.cat([steps, begun], -1))
        hidden = gru(driven, torch.tanh(self.start(s0)), self.recurrent.weight, self.recurrent.bias)
        change = self.outer(functional.silu(self.inner(hidden)))
        return torch.movedim(s0 + change, 0, 2)


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
        self.members = Members(
            ensemble["members"], self.state_size, self.action_size, ensemble["hidden_size"]
        )

    def members_count(self) -> int:
        """M."""
        return int(self.settings["ensemble"]["members"])

    def forward(self, s0: Tensor, actions: Tensor) -> Tensor:
        """ŷ_m of all members: [B, M, T, D] from s_0 [B, D], a_{0:T-1} [B, T, A]."""
        count = self.members_count()
        everyone = self.members(s0.expand(count, *s0.shape), actions.expand(count, *actions.shape))
        return torch.movedim(everyone, 0, 1)

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """See `Model.sample`: row r is the forecast of member[r]."""
        # The K samples of a scenario share s_0 and actions: forecast each scenario once.
        return self(s0, actions)[torch.arange(len(member), device=s0.device), member]

    def training_step(self, batch: dict[str, Tensor]) -> Tensor:
        """−log p_θ of each member under a Gaussian of fixed scale: the squared error.

        The batch has a leading axis M: each member sees the data in its own order.
        """
        states, actions = batch["states"], batch["actions"]
        forecasts = self.members(states[:, :, 0], actions)
        errors = (forecasts - states[:, :, 1:]).square().mean((1, 2, 3))
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
