"""`recurrence.c`, compiled on first use for the processor at hand, and kept for the next time.

Without a C compiler, or with ``STUDY_COMPILED=0`` in the environment, there is no library, and
`study.models.recurrence` computes the same in plain torch.
"""

import ctypes
import hashlib
import logging
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor

SOURCE = Path(__file__).with_name("recurrence.c")
FLAGS = ("-O3", "-march=native", "-fPIC", "-shared")
ROWS = 12
"""Trajectories in a block, as in the source."""

_SIZES = (ctypes.c_long,) * 7 + (ctypes.c_float,)
_ARRAYS = {"forward": 12, "backward": 11}
_log = logging.getLogger(__name__)


@cache
def library() -> ctypes.CDLL | None:
    """The compiled functions; None where there are none."""
    if os.environ.get("STUDY_COMPILED") == "0":
        return None
    compiler = _compiler()
    if compiler is None:
        return None
    try:
        found = ctypes.CDLL(str(_built(compiler)))
    except (OSError, subprocess.SubprocessError) as error:
        _log.warning("recurrent networks run in plain torch, since %s", error)
        return None
    for name, arrays in _ARRAYS.items():
        function = getattr(found, name)
        function.argtypes = _SIZES + (ctypes.c_void_p,) * arrays
        function.restype = None
    return found


def call(
    function: Callable[..., None],
    members: int,
    sizes: tuple[int, int, int, int, int],
    keep: float,
    arrays: tuple[Tensor | None, ...],
) -> None:
    """Call a function of the library for all blocks, on as many threads as torch uses.

    Args:
        function: `forward` or `backward`.
        members: M.
        sizes: B, T, C, D, H.
        keep: see the source.
        arrays: its arrays in their order, float32 and contiguous.
    """
    for array in arrays:
        assert array is None or (array.is_contiguous() and array.dtype == torch.float32)
    pointers = [None if array is None else array.data_ptr() for array in arrays]
    blocks = members * -(-sizes[0] // ROWS)
    threads = min(torch.get_num_threads(), blocks)
    if threads < 2:
        function(0, blocks, *sizes, keep, *pointers)
        return
    ends = [blocks * part // threads for part in range(threads + 1)]
    with ThreadPoolExecutor(threads) as pool:  # while it runs, C does not hold the interpreter
        parts = [
            pool.submit(function, first, last, *sizes, keep, *pointers)
            for first, last in pairwise(ends)
        ]
    for part in parts:
        part.result()


def _compiler() -> str | None:
    names = (os.environ.get("CC", ""), "cc", "gcc", "clang")
    return next((path for name in names if name and (path := shutil.which(name))), None)


def _built(compiler: str) -> Path:
    """The shared library, in a folder of the user's; made if it is not there."""
    version = subprocess.run([compiler, "--version"], capture_output=True, check=True, timeout=30)
    key = hashlib.sha256(SOURCE.read_bytes() + version.stdout + _processor().encode())
    key.update(" ".join(FLAGS).encode())
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "study"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        folder = Path(tempfile.gettempdir())
    path = folder / f"recurrence-{key.hexdigest()[:20]}.so"
    if not path.is_file():
        # Several processes may build at once: each has its own file, and the last one stays.
        with tempfile.TemporaryDirectory(dir=folder) as own:
            built = Path(own) / path.name
            command = [compiler, *FLAGS, str(SOURCE), "-o", str(built)]
            done = subprocess.run(command, capture_output=True, timeout=120, text=True)
            if done.returncode:
                raise OSError(f"{compiler} failed: {done.stderr.strip()[:200]}")
            os.replace(built, path)
    return path


def _processor() -> str:
    """What a program for this very processor depends on."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    wanted = ("model name", "flags", "Features", "CPU part")
    return "\n".join(sorted({line for line in lines if line.startswith(wanted)}))
