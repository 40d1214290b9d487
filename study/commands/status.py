"""Command `status`: the state and the cost of every stage."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

from rich.box import SIMPLE
from rich.console import Console
from rich.live import Live
from rich.table import Table

from study.commands.command import Command, Flag, StudyOptions
from study.commands.terminal import console, say, show
from study.common.errors import BadInput
from study.common.progress import read_progress
from study.config.grid import cells, select
from study.results import timings
from study.workflow.lease import Holder, read_holder
from study.workflow.lock import is_locked, watch
from study.workflow.store import Store
from study.workflow.task import Task
from study.workflow.task_cache import record_tasks, topological_order

DETAILS = """\
The command also works during a run, from another terminal. For each stage that runs, the table has
its machine and process, since when it runs, and the number of the attempt: a stage whose worker was
lost is tried again. For each fit and each forecast that is done, it has the device, such as cpu or
cuda.

With --follow, the stages that run or have failed are shown until the run ends, and then the whole
table. If the output is not a terminal, the table is printed once, at the end.

examples
  python -m study.run status
  python -m study.run status --follow
  python -m study.run status --config configs/paper.yaml --only 'uav/*'"""

Timing = Mapping[str, Any]
"""The cost of a task, measured by `study.workflow.meter.Meter`, with ``began`` and ``threads``. It
is empty if the task has not run. Tasks of earlier versions have fewer entries."""

INTERVAL = 2.0
"""Seconds between two drawings of a table that follows a run."""
PAUSE = 60.0
"""Seconds without a running task after which a study counts as stopped and resumed."""
UNKNOWN = "–"
TO_DO = "to do"
WHERE = ("where", "since", "attempt")
"""Columns of the stages that run."""


@dataclass(frozen=True, kw_only=True)
class Options(StudyOptions):
    """Options of `status`.

    Attributes:
        follow: whether the stages that run are shown until the run ends.
    """

    follow: Annotated[bool, Flag("show the stages that run until the run ends")] = False


def run(options: Options) -> int:
    """Print one line for each task, and the cost of the stages."""
    config, out, terminal = options.config, options.out, console()
    if not out.is_dir():
        raise BadInput(f"--out: there is no study in {out}; start one: python -m study.run all")
    store = Store(out / "work")
    selected = select(cells(config), options.only)
    records = record_tasks(config, store)
    tasks = topological_order(records[cell] for cell in selected)
    published = {} if store.root.is_dir() else timings.read(out)

    def measured() -> dict[Task, Timing]:
        return {task: store.timing(task) or timings.of(task, published) for task in tasks}

    if options.follow:
        _follow(lambda: follow_table(measured(), store, out), out, terminal)
    costs = measured()
    is_running = not options.follow and is_locked(out)
    terminal.print(state_table(costs, store, out, is_running))
    if published:
        say(terminal, f"the stages ran elsewhere: {out} has the results, but no {store.root.name}/")
    show(terminal, cost_table([(task.stage, cost) for task, cost in costs.items()]))
    if not options.only:
        duration = duration_line(costs.values(), timings.parallel_tasks(config, out))
        if duration:
            say(terminal, duration)
    return 0


def _follow(table: Callable[[], Table], out: Path, terminal: Console) -> None:
    """Draw the table again and again while a run that lives holds the results folder."""
    observed = watch(out)
    if not terminal.is_terminal:
        while is_locked(out, observed):
            time.sleep(INTERVAL)
        return
    with Live(console=terminal, auto_refresh=False, transient=True) as live:
        while is_locked(out, observed):
            live.update(table(), refresh=True)
            time.sleep(INTERVAL)


def state_table(costs: Mapping[Task, Timing], store: Store, out: Path, is_running: bool) -> Table:
    """One line for each task: done, running, failed or to do, its wall time and its device.

    Args:
        costs: of each task; empty for a task that is not done.
        store: the folders of the tasks.
        out: the results folder.
        is_running: whether a run holds the folder.
    """
    table = _empty_table(f"{out}{' (a run is going on)' if is_running else ''}")
    holders = {task: _holder(task, store) if is_running else None for task in costs}
    shown = WHERE if any(holders.values()) else ()
    _add_where(table, shown)
    table.add_column("seconds", justify="right")
    table.add_column("device", no_wrap=True)
    total = 0.0
    for task, cost in costs.items():
        seconds = cost.get("seconds")
        total += seconds or 0.0
        state = "done" if seconds is not None else _state(task, store, is_running)
        where = _where(holders[task])[: len(shown)]
        duration = "" if seconds is None else f"{seconds:.1f}"
        table.add_row(task.stage, task.label, state, *where, duration, str(cost.get("device", "")))
    table.add_section()
    table.add_row("all", "", "", *("" for _ in shown), f"{total:.1f}")
    return table


def follow_table(costs: Mapping[Task, Timing], store: Store, out: Path) -> Table:
    """The tasks that run or have failed, since all tasks of a study do not fit on a screen.

    Args:
        costs: of each task; empty for a task that is not done.
        store: the folders of the tasks.
        out: the results folder.
    """
    done = sum("seconds" in cost for cost in costs.values())
    table = _empty_table(f"{out}: {done} of {len(costs)} stages are done")
    _add_where(table, WHERE)
    for task, cost in costs.items():
        state = "done" if "seconds" in cost else _state(task, store, is_running=True)
        if state not in ("done", TO_DO):
            table.add_row(task.stage, task.label, state, *_where(_holder(task, store)))
    return table


def _empty_table(title: str) -> Table:
    """A table with the columns of a task. In a narrow terminal, long names and errors wrap."""
    table = Table(title=title, box=SIMPLE, padding=(0, 1, 0, 0))
    table.add_column("stage", no_wrap=True)
    for column in ("for", "state"):
        table.add_column(column, overflow="fold")
    return table


def _add_where(table: Table, columns: Sequence[str]) -> None:
    """Add the columns of the tasks that run: `WHERE`, or none of them."""
    for column in columns:
        table.add_column(column, overflow="fold", no_wrap=column != "where")


def cost_table(timings: Sequence[tuple[str, Timing]]) -> Table:
    """One line for each stage: tasks, wall time, CPU time, share of wall time, and peak memory.

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
    """The duration of the study from first start to last end, and the use of the cores.

    Args:
        timings: cost of every task of the study.
        workers: number of tasks that ran in parallel.

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
    """The state of a task that is not done. A killed run may have left the task's progress file."""
    if is_running and store.progress(task).exists():
        progress = read_progress(store.progress(task))
        return f"running {progress.get('fraction', 0.0):.0%} {progress.get('message', '')}"
    with suppress(FileNotFoundError):  # a new attempt removes it
        return f"failed: {store.failure(task).read_text(encoding='utf-8').strip()}"
    return TO_DO


def _holder(task: Task, store: Store) -> Holder | None:
    """The process that runs the task; None if none does, or if it has ended."""
    with suppress(OSError):
        holder = read_holder(store.lease(task))
        return None if holder is None or holder.has_ended else holder
    return None


def _where(holder: Holder | None) -> tuple[str, ...]:
    """The cells of `WHERE`."""
    if holder is None:
        return ("",) * len(WHERE)
    since = datetime.fromisoformat(holder.since)
    is_today = since.date() == datetime.now(since.tzinfo).date()
    at = f"{since:%H:%M:%S}" if is_today else f"{since:%Y-%m-%d %H:%M}"
    return f"{holder.host}, process {holder.process}", at, str(holder.attempt)


def _cost_columns(timings: Sequence[Timing], total: float) -> list[str]:
    """The columns after the name of the stage; `total` is the wall time of all stages."""
    measured = [timing for timing in timings if "seconds" in timing]
    seconds, cpu = (_sum(measured, quantity) for quantity in ("seconds", "cpu_seconds"))
    peaks = [timing["peak_memory"] for timing in measured if "peak_memory" in timing]
    count = f"{len(measured)}"
    return [
        count if len(measured) == len(timings) else f"{count} of {len(timings)}",
        UNKNOWN if seconds is None else f"{seconds:.1f}",
        UNKNOWN if cpu is None else f"{cpu:.1f}",
        UNKNOWN if seconds is None or not total else f"{seconds / total:.0%}",
        f"{max(peaks) / 1e6:.0f}" if peaks else UNKNOWN,
    ]


def _sum(timings: Sequence[Timing], quantity: str) -> float | None:
    """The sum over tasks; None if a task has no value."""
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


COMMAND = Command("status", "print the state and the cost of every stage", Options, run, DETAILS)
