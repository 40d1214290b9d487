"""The deep ensemble of recurrent networks: the epistemic part (section III-A, equation 9)."""

from typing import Any

import torch
from torch import Tensor, nn

from study.data.normalization import Normalization
from study.models.base import Model
from study.models.gru.recurrence import feedback_gru, gru
from study.models.networks.likelihood import negative_log_likelihood


class StackedLinear(nn.Module):
    """M linear maps side by side: [..., M, B, I] → [..., M, B, O]."""

    def __init__(self, members: int, inputs: int, outputs: int, bias: bool = True) -> None:
        super().__init__()
        # Each member is initialised as torch.nn.Linear would be, from draws of its own.
        bound = inputs**-0.5
        self.weight = nn.Parameter(torch.empty(members, inputs, outputs).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.zeros(members, 1, outputs), requires_grad=bias)
        # Not read from the parameter: one that is frozen counts all the same.
        self.biased = bias

    def forward(self, values: Tensor) -> Tensor:
        """See the class."""
        product = values @ self.weight
        return product + self.bias if self.biased else product


class Members(nn.Module):
    """M recurrent networks for p_θ(s_{1:T} | s_0; a_{0:T-1}), computed side by side.

    A member is driven by the actions and by its own last state, to which it adds a change, in
    units of the change that a step usually brings.

    Args:
        members: M.
        delta_std: [D].
        action_size: A.
        hidden_size: H.
    """

    delta_std: Tensor

    def __init__(self, members: int, delta_std: Tensor, action_size: int, hidden_size: int) -> None:
        super().__init__()
        state_size = len(delta_std)
        self.register_buffer("delta_std", delta_std.clone())
        self.start = StackedLinear(members, state_size, hidden_size)
        self.driven = StackedLinear(members, action_size, 3 * hidden_size)
        self.feed = StackedLinear(members, state_size, 3 * hidden_size, bias=False)
        self.recurrent = StackedLinear(members, hidden_size, 3 * hidden_size)
        self.out = StackedLinear(members, hidden_size, state_size)

    def forward(self, s0: Tensor, actions: Tensor, truth: Tensor | None = None) -> Tensor:
        """ŝ_{1:T} [M, B, T, D] from s_0 [M, B, D] and a_{0:T-1} [M, B, T, A], in standard units.

        With `truth` s_{0:T-1} [M, B, T, D] each step begins at the true state: teacher forcing.
        """
        hidden, recurrent, feed = torch.tanh(self.start(s0)), self.recurrent, self.feed.weight
        out, drift = self.out.weight * self.delta_std, self.out.bias * self.delta_std
        enter = torch.cat([self.driven.weight, feed], dim=1)
        weight, bias = recurrent.weight, torch.cat([self.driven.bias, recurrent.bias], dim=1)
        if truth is None:
            steady = drift[:, :, None].expand(*actions.shape[:-1], -1)
            return feedback_gru(actions, steady, hidden, s0, enter, weight, bias, out, 1.0)[1]
        hiddens = gru(torch.cat([actions, truth], -1), hidden, enter, weight, bias)
        return truth + hiddens @ out[:, None] + drift[:, :, None]


class Ensemble(Model):
    """M members, fitted side by side; they differ by initialisation and by the order of the data.

    As a forecaster it is the reference "ensemble alone": each sample is one member's forecast,
    m ~ U{0 … M−1}.
    """

    sections = ("ensemble",)
    noise_size = 0

    def __init__(self, normalization: Normalization, settings: dict[str, Any]) -> None:
        super().__init__(normalization, settings)
        ensemble = settings["ensemble"]
        self.members = Members(
            ensemble["members"], self.delta_std, self.action_size, ensemble["hidden_size"]
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
        """See `Model.sample`: sample k of a scenario is the forecast of member[k]."""
        scenarios = torch.arange(len(s0), device=s0.device)[:, None]
        return self(s0, actions)[scenarios, member]

    def training_step(self, batch: dict[str, Tensor]) -> Tensor:
        """−log p_θ of each member, averaged over trajectories and t, and over the dimensions.

        The batch has a leading axis M: each member sees the data in its own order. The first steps
        are taught one transition at a time, which is quick to learn and where to begin from; then
        whole forecasts count.
        """
        states, actions, options = batch["states"], batch["actions"], self.settings["ensemble"]
        s0, truth = states[:, :, 0], states[:, :, 1:]
        if self.global_step < options["teacher_forcing_fraction"] * options["steps"]:
            forecasts = self.members(s0, actions, states[:, :, :-1])
        else:
            forecasts = self.members(s0, actions)
        losses = negative_log_likelihood((forecasts - truth).square().mean((1, 2))).mean(-1)
        self.tell({f"loss/member_{index}": loss for index, loss in enumerate(losses)})
        # The members share no parameter, so the sum's gradient is each member's own.
        return losses.sum()

    def validation_step(self, batch: dict[str, Tensor]) -> None:
        """−log p_θ on trajectories not trained on, averaged over the members."""
        forecasts = self(*self.normalize(batch["s0"], batch["actions"]))[:, :, None]
        truth = self.normalize_states(batch["observed"])
        squared_error = (forecasts - truth[:, None]).square().mean((0, 2, 3))
        losses = negative_log_likelihood(squared_error).mean(-1)
        for index, loss in enumerate(losses):
            self.log(f"validation/member_{index}", loss, batch_size=len(forecasts))
        self.log("validation_score", losses.mean(), batch_size=len(forecasts))

    def configure_optimizers(self) -> Any:
        """See `Model.optimised`."""
        return self.optimised(self.settings["ensemble"])
