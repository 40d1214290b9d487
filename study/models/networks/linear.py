"""A linear layer for each of several independent networks."""

import torch
from torch import Tensor, nn


class StackedLinear(nn.Module):
    """M independent linear maps y_m = x_m W_m + b_m, computed together.

    Each is initialised like `torch.nn.Linear`, except that biases are 0.

    Args:
        members: M.
        inputs: I.
        outputs: O.
        bias: whether the maps have biases. If not, the parameter `bias` stays 0.
    """

    def __init__(self, members: int, inputs: int, outputs: int, bias: bool = True) -> None:
        super().__init__()
        bound = inputs**-0.5
        self.weight = nn.Parameter(torch.empty(members, inputs, outputs).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.zeros(members, 1, outputs), requires_grad=bias)
        # Not `self.bias.requires_grad`: a trained bias may be frozen later.
        self.has_bias = bias

    def forward(self, values: Tensor) -> Tensor:
        """[..., M, B, O] from [..., M, B, I]."""
        product = values @ self.weight
        return product + self.bias if self.has_bias else product
