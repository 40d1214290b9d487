"""Timing side by side, as the benchmarks need it."""

import os
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import torch

from study.workflow.engine import MEMORY


def as_a_worker() -> None:
    """One thread, and memory handled as in the study's worker processes; for all contenders.

    The environment has its say only before a process starts, so the script starts again with it.
    """
    wanted = MEMORY | {"OMP_NUM_THREADS": "1"}
    if any(os.environ.get(name) != value for name, value in wanted.items()):
        os.execve(sys.executable, sys.orig_argv, os.environ | wanted)
    torch.set_num_threads(1)


@dataclass
class Timing:
    """Seconds of each repeat: of the processor, and on the clock."""

    processor: list[float] = field(default_factory=list)
    clock: list[float] = field(default_factory=list)

    def median(self) -> float:
        """Of the processor's seconds: what other programs do matters less to it."""
        return float(np.median(self.processor))


def interleave(contenders: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, Timing]:
    """Run all contenders in turn, `repeats` times, after once unmeasured."""
    timings = {name: Timing() for name in contenders}
    for repeat in range(-1, repeats):
        for name, run in contenders.items():
            clock, processor = time.perf_counter(), time.thread_time()
            run()
            if repeat >= 0:
                timings[name].processor.append(time.thread_time() - processor)
                timings[name].clock.append(time.perf_counter() - clock)
    return timings


def times_as_fast(ours: Timing, theirs: Timing, work: float = 1.0) -> tuple[float, float, float]:
    """Median, least and greatest ratio of rates over the repeats; `work`: ours by theirs."""
    ratios = work * np.divide(theirs.processor, ours.processor)
    return float(np.median(ratios)), float(ratios.min()), float(ratios.max())


def verdict(ratio: float, target: float) -> str:
    """Of a ratio that is wanted to be at least so much."""
    return f"at least {target}: {'yes' if ratio >= target else 'no'}"
