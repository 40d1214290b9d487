"""The device of the scores that take longest: MMD, joint MMD and the energy score.

By default they are computed on the CPU, with numpy. On a GPU they are computed in float64 as well,
in larger blocks. The results agree to 1e-6 or better; the tests compare them.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import torch

_device: ContextVar[torch.device | None] = ContextVar("device", default=None)

AT_ONCE = 2**24
"""Numbers that a GPU processes at once. It bounds the memory."""


@contextmanager
def scores_on(device: torch.device | None) -> Iterator[None]:
    """Compute the scores of this block on a device.

    Args:
        device: with float64; None for numpy.
    """
    token = _device.set(device)
    try:
        yield
    finally:
        _device.reset(token)


def score_device() -> torch.device | None:
    """The device of `scores_on`; None for numpy."""
    return _device.get()


def at_once(on_cpu: int) -> int:
    """Numbers that are processed at once.

    Args:
        on_cpu: their number on the CPU.
    """
    return on_cpu if score_device() is None else AT_ONCE
