"""The cost of a task: wall time, CPU time and peak memory of this process."""

import ctypes
import os
import sys
import time
from contextlib import suppress
from pathlib import Path

STATUS, CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
LIMIT = Path("/sys/fs/cgroup/memory.max")


class Meter:
    """Measures from its creation on. Use one at a time, since a process has one peak of memory."""

    def __init__(self) -> None:
        _trim_memory()
        self._peak = _reset_peak()
        self._wall, self._cpu = time.perf_counter(), _cpu()

    def read(self) -> dict[str, float]:
        """The cost so far.

        Returns:
            ``seconds``, wall time; ``cpu_seconds``, of all threads of this process and of its child
            processes that have ended; ``peak_memory`` in bytes, the largest resident set of this
            process, libraries included, where the system reports it.
        """
        cost = {"seconds": time.perf_counter() - self._wall, "cpu_seconds": _cpu() - self._cpu}
        peak = _peak() if self._peak else None
        return cost if peak is None else cost | {"peak_memory": peak}


def memory_size() -> int:
    """The memory of this machine, or of the container of this process, in bytes."""
    installed = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    with suppress(OSError, ValueError):  # no such file, or the word max
        return min(installed, int(LIMIT.read_text(encoding="utf-8")))
    return installed


def _cpu() -> float:
    ended = os.times()
    return time.process_time() + ended.children_user + ended.children_system


def _trim_memory() -> None:
    """Return freed memory to the system, so that it does not count for the next task."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # another C library
            ctypes.CDLL(None).malloc_trim(0)


def _reset_peak() -> bool:
    """Reset the peak of resident memory, which only Linux can.

    Returns:
        whether the peak was reset.
    """
    try:
        CLEAR.write_text("5", encoding="utf-8")
    except OSError:
        return False
    return _peak() is not None


def _peak() -> int | None:
    """The peak of resident memory in bytes since `_reset_peak`; None if unknown."""
    try:
        lines = STATUS.read_text(encoding="utf-8").splitlines()
        (kibibytes,) = (line.split()[1] for line in lines if line.startswith("VmHWM:"))
    except (OSError, ValueError, IndexError):
        return None
    return int(kibibytes) * 1024
