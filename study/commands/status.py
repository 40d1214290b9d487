"""Command `status`: what is done, running or failed, and what it cost."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from rich.box import SIMPLE
from rich.table import Table

from study.commands.command import Command, StudyOptions
from study.commands.terminal import console, say
from study.common.errors import BadInput
from study.common.progress import read_progress
from study.config.grid import cells, select
from study.results.timings import parallel_tasks
from study.workflow.lock import is_locked
from study.workflow.store import Store
from study.workflow.task import Task
from study.workflow.task_cache import record_tasks, topological_order

DETAILS = """\
It can be asked while a run goes on, from another terminal.

examples
  python -m study.run status
  python -m study.run status --config configs/paper.yaml --only 'uav/*'"""

Timing = Mapping[str, Any]
"""What one task cost, as `study.workflow.meter.Meter` measured it, with ``began`` and ``threads``.
It is empty if the task has not run. Tasks of earlier versions have fewer entries."""

PAUSE = 60.0
"""Seconds without a running task after which a study counts as stopped and resumed."""
UNKNOWN = "–"


@dataclass(frozen=True, kw_only=True)
class Options(StudyOptions):
    """Options of `status`: the settings alone."""


def run(options: Options) -> int:
    """Print one line for each stage, and what the stages cost."""
    config, out, terminal = options.config, options.out, console()
    if not out.is_dir():
        raise BadInput(f"--out: there is no study in {out}; start one: python -m study.run all")
    store = Store(out / "work")
    chosen = select(cells(config), options.only)
    records = record_tasks(config, store)
    tasks = topological_order(records[cell] for cell in chosen)
    timings = [(task.stage, store.timing(task)) for task in tasks]
    terminal.print(state_table(tasks, store, out))
    terminal.print(cost_table(timings))
    if not options.only:
        duration = duration_line([timing for _, timing in timings], parallel_tasks(config, out))
        if duration:
            say(terminal, duration)
    return 0


def state_table(tasks: Sequence[Task], store: Store, out: Path) -> Table:
    """One line a task: whether it is done, running, failed or to do, and its wall time."""
    is_running = is_locked(out)
    table = Table(title=f"{out}{' (a run is going on)' if is_running else ''}", box=SIMPLE)
    for column in ("stage", "for", "state"):
        table.add_column(column, no_wrap=True)
    table.add_column("seconds", justify="right")
    total = 0.0
    for task in tasks:
        seconds = store.timing(task).get("seconds")
        total += seconds or 0.0
        state = "done" if seconds is not None else _state(task, store, is_running)
        table.add_row(task.stage, task.label, state, "" if seconds is None else f"{seconds:.1f}")
    table.add_section()
    table.add_row("all", "", "", f"{total:.1f}")
    return table


def cost_table(timings: Sequence[tuple[str, Timing]]) -> Table:
    """One line a stage: tasks, wall and CPU time, share of all wall time, largest peak memory.

    Args:
        timings: stage and cost of each task.
    """
    table = Table(title="cost of the stages", box=SIMPLE)
    table.add_column("stage", no_wrap=True)
    for column in ("tasks", "seconds", "CPU seconds", "share", "peak memory, MB"):
        table.add_column(column, justify="right", no_wrap=True)
    total = sum(timing.get("seconds", 0.0) for _, timing in timings)
    for stage in dict.fromkeys(stage for stage, _ in timings):
        costs = [timing for name, timing in timings if name == stage]
        table.add_row(stage, *_cost_columns(costs, total))
    table.add_section()
    table.add_row("all", *_cost_columns([timing for _, timing in timings], total))
    return table


def duration_line(timings: Iterable[Timing], workers: int) -> str:
    """How long the study took from first start to last end, and how busy the cores were.

    Args:
        timings: cost of every task of the study.
        workers: how many tasks ran in parallel.

    Returns:
        one line; empty if a task has not run.
    """
    timings = list(timings)
    if not timings or not all({"began", "seconds"} <= timing.keys() for timing in timings):
        return ""
    durations = _durations(timings)
    if len(durations) > 1:
        return f"it ran in {len(durations)} parts, {sum(durations):.0f} s in all"
    line = f"{durations[0]:.0f} s from first start to last end"
    cpu, threads = _sum(timings, "cpu_seconds"), {timing.get("threads", 0) for timing in timings}
    cores = workers * int(threads.pop())
    if cpu is None or threads or not cores:  # unknown, or not the same for all tasks
        return line
    busy = cpu / durations[0] / cores
    return f"{line}; {cores} {'core' if cores == 1 else 'cores'}, {busy:.0%} busy"


def _state(task: Task, store: Store, is_running: bool) -> str:
    """The state of a task that is not done; a killed run may have left its progress file."""
    if is_running and store.progress(task).exists():
        progress = read_progress(store.progress(task))
        return f"running {progress.get('fraction', 0.0):.0%} {progress.get('message', '')}"
    if store.failure(task).exists():
        return f"failed: {store.failure(task).read_text().strip()}"
    return "to do"


def _cost_columns(timings: Sequence[Timing], total: float) -> list[str]:
    """The columns after the name of the stage; `total` is the wall time of all stages."""
    done = [timing for timing in timings if "seconds" in timing]
    seconds, cpu = (_sum(done, quantity) for quantity in ("seconds", "cpu_seconds"))
    peaks = [timing["peak_memory"] for timing in done if "peak_memory" in timing]
    return [
        f"{len(done)}" if len(done) == len(timings) else f"{len(done)} of {len(timings)}",
        UNKNOWN if seconds is None else f"{seconds:.1f}",
        UNKNOWN if cpu is None else f"{cpu:.1f}",
        UNKNOWN if seconds is None or not total else f"{seconds / total:.0%}",
        f"{max(peaks) / 1e6:.0f}" if peaks else UNKNOWN,
    ]


def _sum(timings: Sequence[Timing], quantity: str) -> float | None:
    """The sum over tasks; None if it is unknown for one of them."""
    values = [timing.get(quantity) for timing in timings]
    numbers = [float(value) for value in values if value is not None]
    return sum(numbers) if numbers and len(numbers) == len(values) else None


def _durations(timings: Iterable[Timing]) -> list[float]:
    """The seconds of each uninterrupted part of the study."""
    starts = ((datetime.fromisoformat(t["began"]).timestamp(), t["seconds"]) for t in timings)
    parts: list[tuple[float, float]] = []
    for start, seconds in sorted(starts):
        if parts and start - parts[-1][1] <= PAUSE:
            parts[-1] = parts[-1][0], max(parts[-1][1], start + seconds)
        else:
            parts.append((start, start + seconds))
    return [end - start for start, end in parts]


COMMAND = Command(
    "status", "say what is done, running or failed, and what it cost", Options, run, DETAILS
)
