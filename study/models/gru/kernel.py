"""The functions of `recurrence.c`, compiled on first use.

There is no library without a C compiler, or with ``STUDY_COMPILED=0`` in the environment.
`study.models.gru.recurrence` then computes the same in torch.
"""

import ctypes
import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor

from study.models.gru import compiler

SOURCE = Path(__file__).with_name("recurrence.c")
ROWS = 12
"""Number of trajectories of a block, as in the source."""

_SIZES = (ctypes.c_long,) * 7 + (ctypes.c_float,)
_ARRAYS = {"forward": 14, "backward": 11}
_log = logging.getLogger(__name__)


@cache
def library() -> ctypes.CDLL | None:
    """The compiled functions; None where they cannot be compiled."""
    if (path := compiler.find()) is None:
        return None
    try:
        compiled = ctypes.CDLL(str(compiler.build(SOURCE, path)))
    except OSError as error:
        _log.warning("recurrent networks run in plain torch: %s", error)
        return None
    for name, arrays in _ARRAYS.items():
        function = getattr(compiled, name)
        function.argtypes = _SIZES + (ctypes.c_void_p,) * arrays
        function.restype = None
    return compiled


def call(
    function: Callable[..., None],
    members: int,
    sizes: tuple[int, int, int, int, int],
    residual: float,
    arrays: tuple[Tensor | None, ...],
) -> None:
    """Call a function of the library for all blocks, on as many threads as torch uses.

    Args:
        function: `forward` or `backward` of the library.
        members: M.
        sizes: B, T, C, D, H.
        residual: see `study.models.gru.recurrence.feedback_gru`.
        arrays: the arrays in the order of the source, float32 and contiguous.
    """
    for array in arrays:
        assert array is None or (array.is_contiguous() and array.dtype == torch.float32)
    pointers = [None if array is None else array.data_ptr() for array in arrays]
    blocks = members * -(-sizes[0] // ROWS)
    threads = min(torch.get_num_threads(), blocks)
    if threads < 2:
        function(0, blocks, *sizes, residual, *pointers)
        return
    bounds = [blocks * part // threads for part in range(threads + 1)]
    with ThreadPoolExecutor(threads) as pool:  # ctypes releases the interpreter's lock
        calls = [
            pool.submit(function, first, last, *sizes, residual, *pointers)
            for first, last in pairwise(bounds)
        ]
    for finished in calls:
        finished.result()
