"""What the stages of a study took: time, cores, memory; from the numbers that each task left.

A task's numbers are `study.workflow.meter.Meter`'s, with ``began`` and ``threads``. Tasks of
earlier versions have fewer; where one is missing, no sum is made up.
"""

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any

from rich.box import SIMPLE
from rich.table import Table

Timing = Mapping[str, Any]
# Longer than this with no task under way, and the study was stopped and went on later.
PAUSE = 60.0
UNKNOWN = "–"


def by_stage(timings: Sequence[tuple[str, Timing]]) -> Table:
    """One line a stage: tasks, wall and CPU seconds, its share of all, peak memory of one task.

    Args:
        timings: stage and numbers of each task; no numbers if it has not run.
    """
    table = Table(title="what the stages took", box=SIMPLE)
    table.add_column("stage", no_wrap=True)
    for column in ("tasks", "seconds", "CPU seconds", "share", "peak memory, MB"):
        table.add_column(column, justify="right", no_wrap=True)
    whole = sum(timing.get("seconds", 0.0) for _, timing in timings)
    for stage in dict.fromkeys(stage for stage, _ in timings):
        table.add_row(stage, *_row([timing for name, timing in timings if name == stage], whole))
    table.add_section()
    table.add_row("all", *_row([timing for _, timing in timings], whole))
    return table


def in_all(timings: Iterable[Timing], workers: int) -> str:
    """From first start to last end, and how busy the cores were; empty until all have run.

    Args:
        timings: of each task of the study.
        workers: how many tasks ran side by side.
    """
    timings = list(timings)
    if not timings or not all({"began", "seconds"} <= timing.keys() for timing in timings):
        return ""
    goes = _goes(timings)
    if len(goes) > 1:
        return f"it ran in {len(goes)} goes, {sum(goes):.0f} s in all"
    line = f"{goes[0]:.0f} s from first start to last end"
    cpu, threads = _total(timings, "cpu_seconds"), {t.get("threads", 0) for t in timings}
    cores = workers * int(threads.pop())
    if cpu is None or threads or not cores:  # not known, or not one number
        return line
    return f"{line}; {cores} {'core' if cores == 1 else 'cores'}, {cpu / goes[0] / cores:.0%} busy"


def _row(timings: list[Timing], whole: float) -> list[str]:
    """The columns after the stage's name."""
    done = [timing for timing in timings if "seconds" in timing]
    seconds, cpu = (_total(done, quantity) for quantity in ("seconds", "cpu_seconds"))
    peaks = [timing["peak_memory"] for timing in done if "peak_memory" in timing]
    return [
        f"{len(done)}" if len(done) == len(timings) else f"{len(done)} of {len(timings)}",
        UNKNOWN if seconds is None else f"{seconds:.1f}",
        UNKNOWN if cpu is None else f"{cpu:.1f}",
        UNKNOWN if seconds is None or not whole else f"{seconds / whole:.0%}",
        f"{max(peaks) / 1e6:.0f}" if peaks else UNKNOWN,
    ]


def _total(timings: list[Timing], quantity: str) -> float | None:
    """The sum over tasks, if there are any and every one has it."""
    values = [timing.get(quantity) for timing in timings]
    numbers = [float(value) for value in values if value is not None]
    return sum(numbers) if numbers and len(numbers) == len(values) else None


def _goes(timings: Iterable[Timing]) -> list[float]:
    """The seconds of each time that the study ran without a pause."""
    begins = ((datetime.fromisoformat(t["began"]).timestamp(), t["seconds"]) for t in timings)
    goes: list[tuple[float, float]] = []
    for begin, seconds in sorted(begins):
        if goes and begin - goes[-1][1] <= PAUSE:
            goes[-1] = goes[-1][0], max(goes[-1][1], begin + seconds)
        else:
            goes.append((begin, begin + seconds))
    return [end - begin for begin, end in goes]
