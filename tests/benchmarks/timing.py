"""Timing of several contenders in turn."""

import os
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import torch

from study.workflow.cluster import MEMORY


def cores() -> int:
    """The processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def as_a_worker() -> None:
    """Use one thread, and handle memory as the study's worker processes do.

    The settings of memory count only when a process starts, so the script starts again with them.
    """
    settings = MEMORY | {"OMP_NUM_THREADS": "1"}
    if any(os.environ.get(name) != value for name, value in settings.items()):
        os.execve(sys.executable, sys.orig_argv, os.environ | settings)
    torch.set_num_threads(1)


@dataclass
class Timing:
    """Processor seconds of every repeat; other programs matter less to them than to the clock."""

    seconds: list[float] = field(default_factory=list)

    def median(self) -> float:
        """Median over the repeats."""
        return float(np.median(self.seconds))


def interleave(contenders: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, Timing]:
    """Run all contenders in turn, once unmeasured and then `repeats` times."""
    timings = {name: Timing() for name in contenders}
    for repeat in range(-1, repeats):
        for name, run in contenders.items():
            start = time.thread_time()
            run()
            if repeat >= 0:
                timings[name].seconds.append(time.thread_time() - start)
    return timings


def times_as_fast(ours: Timing, theirs: Timing, work: float = 1.0) -> list[float]:
    """Median, least and greatest ratio of our rate to theirs over the repeats.

    Args:
        ours: our timing.
        theirs: the other contender's timing.
        work: our amount of work divided by theirs.
    """
    ratios = work * np.divide(theirs.seconds, ours.seconds)
    return [float(np.median(ratios)), float(ratios.min()), float(ratios.max())]
