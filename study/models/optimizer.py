"""The optimiser and the learning rate of all models."""

from collections.abc import Iterable

import torch
from torch.nn import Parameter
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler, OneCycleLR


def adamw(parameters: Iterable[Parameter], learning_rate: float, weight_decay: float) -> Optimizer:
    """AdamW (Loshchilov and Hutter, ICLR 2019), with weight decay on matrices alone.

    Each step multiplies the matrices by 1 − learning_rate · weight_decay. Biases do not decay.
    """
    matrices: list[Parameter] = []
    vectors: list[Parameter] = []
    for parameter in parameters:
        # The biases of stacked networks are [M, 1, ...].
        is_matrix = parameter.dim() > 1 and parameter.shape[-2] > 1
        (matrices if is_matrix else vectors).append(parameter)
    groups = [
        {"params": matrices, "weight_decay": weight_decay},
        {"params": vectors, "weight_decay": 0.0},
    ]
    return torch.optim.AdamW(groups, lr=learning_rate, fused=True)


def one_cycle(optimizer: Optimizer, learning_rate: float, steps: int) -> LRScheduler:
    """The learning rate rises over the first tenth of the steps, then falls to nearly 0.

    With fewer than ten steps it only falls.
    """
    rise = 0.1 if steps > 9 else 0.0  # torch divides by zero if the rise ends at step 0
    return OneCycleLR(optimizer, max_lr=learning_rate, total_steps=steps + 1, pct_start=rise)
