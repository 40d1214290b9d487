"""The recurrent network of the ensemble's members (section III-A)."""

import torch
from torch import Tensor, nn

from study.models.gru.recurrence import feedback_gru, gru
from study.models.networks.linear import StackedLinear


class StackedRnn(nn.Module):
    """M independent recurrent networks for p_θ(s_{1:T} | s_0; a_{0:T-1}), computed together.

    The inputs of a GRU are the action and its own last state. Its output is the state's change:

        h_0 = tanh(s_0 W_0 + b_0)
        h_{t+1} = GRU([a_t, ŝ_t], h_t)
        ŝ_{t+1} = ŝ_t + δ · (h_{t+1} W_o + b_o)

    where δ is the standard deviation of a state's change over one step.

    Args:
        members: M.
        delta_std: δ [D].
        action_size: A.
        hidden_size: H.
    """

    delta_std: Tensor

    def __init__(self, members: int, delta_std: Tensor, action_size: int, hidden_size: int) -> None:
        super().__init__()
        state_size = len(delta_std)
        self.register_buffer("delta_std", delta_std.clone())
        self.initial_hidden = StackedLinear(members, state_size, hidden_size)
        self.gates_of_action = StackedLinear(members, action_size, 3 * hidden_size)
        self.gates_of_state = StackedLinear(members, state_size, 3 * hidden_size, bias=False)
        self.gates_of_hidden = StackedLinear(members, hidden_size, 3 * hidden_size)
        self.output = StackedLinear(members, hidden_size, state_size)

    def forward(self, s0: Tensor, actions: Tensor, truth: Tensor | None = None) -> Tensor:
        """ŝ_{1:T} [M, B, T, D] in normalised units.

        Args:
            s0: [M, B, D].
            actions: a_{0:T-1} [M, B, T, A].
            truth: s_{0:T-1} [M, B, T, D], the last states with teacher forcing. If None, each step
                starts at the network's own prediction.
        """
        hidden = torch.tanh(self.initial_hidden(s0))
        weight_ih = torch.cat([self.gates_of_action.weight, self.gates_of_state.weight], dim=1)
        weight_hh = self.gates_of_hidden.weight
        bias = torch.cat([self.gates_of_action.bias, self.gates_of_hidden.bias], dim=1)
        weight_ho, bias_o = self.output.weight * self.delta_std, self.output.bias * self.delta_std
        if truth is None:
            offset = bias_o[:, :, None].expand(*actions.shape[:-1], -1)
            weights = (weight_ih, weight_hh, bias, weight_ho)
            return feedback_gru(actions, offset, hidden, s0, *weights, residual=1.0)[1]
        hiddens = gru(torch.cat([actions, truth], -1), hidden, weight_ih, weight_hh, bias)
        return truth + hiddens @ weight_ho[:, None] + bias_o[:, :, None]
