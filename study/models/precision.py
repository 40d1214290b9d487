"""Float32 inside bfloat16 training: what is never computed in bfloat16.

With ``train.precision`` at `bf16`, matrix products of a training step are computed in bfloat16
(Lightning's ``bf16-mixed``, by `torch.autocast`). A recurrence adds up the rounding of all its
steps, and a logarithmic score divides by small variances. So both are computed in float32.
"""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import torch
from torch import Tensor

R = TypeVar("R")


def in_float32(function: Callable[..., R]) -> Callable[..., R]:
    """Decorator: the function computes in float32, also within `torch.autocast`.

    Arguments in bfloat16 are converted. Without autocast nothing changes.
    """

    @wraps(function)
    def run(*arguments: Any, **named: Any) -> R:
        values = (*arguments, *named.values())
        device = next(value.device.type for value in values if isinstance(value, Tensor))
        if not torch.is_autocast_enabled(device):
            return function(*arguments, **named)
        with torch.autocast(device, enabled=False):
            converted = {name: _convert(value) for name, value in named.items()}
            return function(*map(_convert, arguments), **converted)

    return run


def _convert(value: Any) -> Any:
    return value.float() if isinstance(value, Tensor) and value.dtype == torch.bfloat16 else value
