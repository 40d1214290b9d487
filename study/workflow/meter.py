"""What a piece of work costs this process: wall time, CPU time, peak memory."""

import ctypes
import os
import sys
import time
from contextlib import suppress
from pathlib import Path

STATUS, CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")


class Meter:
    """Measures from its making on; one at a time in a process."""

    def __init__(self) -> None:
        _give_back()
        self._peak = _forget_peak()
        self._wall, self._cpu = time.perf_counter(), _cpu()

    def read(self) -> dict[str, float]:
        """What it took so far.

        Returns:
            ``seconds`` of wall time; ``cpu_seconds`` of all threads of this process, and of
            processes that it started and that have ended; and ``peak_memory``, the most bytes that
            this process itself held at once, its libraries included, where the system can tell.
        """
        used = {"seconds": time.perf_counter() - self._wall, "cpu_seconds": _cpu() - self._cpu}
        peak = _peak() if self._peak else None
        return used if peak is None else used | {"peak_memory": peak}


def _cpu() -> float:
    ended = os.times()
    return time.process_time() + ended.children_user + ended.children_system


def _give_back() -> None:
    """Return what earlier work has freed: the allocator may keep it, and it is not this work's."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # another C library
            ctypes.CDLL(None).malloc_trim(0)


def _forget_peak() -> bool:
    """Begin to look for the peak anew. Only Linux can; elsewhere it is that of the whole process.

    Returns:
        whether it could.
    """
    try:
        CLEAR.write_text("5")
    except OSError:
        return False
    return _peak() is not None


def _peak() -> int | None:
    """The most bytes that this process held since `_forget_peak`."""
    try:
        lines = STATUS.read_text(encoding="utf-8").splitlines()
        (kibibytes,) = (line.split()[1] for line in lines if line.startswith("VmHWM:"))
    except (OSError, ValueError, IndexError):
        return None
    return int(kibibytes) * 1024
