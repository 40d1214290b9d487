"""What the terminal shows of a study as a whole: the final table, the state of its stages."""

import platform
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from study.claims.paper import BRIER
from study.commands import usage
from study.common.files import read_json, write_json
from study.common.progress import read_progress
from study.config.grid import Cell
from study.config.settings import Config
from study.workflow.engine import workers
from study.workflow.lock import is_locked
from study.workflow.store import Store, Task

TIMINGS = "timings.json"


def print_table(
    console: Console,
    config: Config,
    records: Mapping[Cell, Task],
    store: Store,
    errors: Mapping[Task, str],
    out: Path,
) -> None:
    """One row a cell: β, MMD², Brier score, the oracle's Brier score, the paper's."""
    scores = _overall(out / "scores.parquet")
    title = f"{config.name}: MMD² and Brier scores (lower is better)"
    table = Table(title=title, box=SIMPLE, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("cell", no_wrap=True)
    for column in ("β", "MMD²", "Brier", "oracle", "paper"):
        table.add_column(column, justify="right", no_wrap=True)
    for cell, record in records.items():
        mmd2, brier = (_value(scores, cell, metric) for metric in ("mmd2", "brier"))
        oracle = Cell(cell.environment, cell.level, "oracle", cell.seed)
        table.add_row(
            cell.name,
            "failed" if record in errors else _beta(record, store),
            _number(mmd2, 4),
            _number(brier, 3),
            _number(_value(scores, oracle, "brier"), 3),
            _number(BRIER.get((cell.environment, cell.level, cell.model)), 3),
        )
    console.print(table)
    shown = {
        "claims": out / "claims.md",
        "tables": out / "tables",
        "figures": out / "figures",
        "recordings": out / "recordings",
    }
    for name, path in shown.items():
        console.print(f"{name:11} {path}", soft_wrap=True)
    for task, error in errors.items():
        console.print(f"FAILED {task.name}: {error}  log: {store.log(task)}", soft_wrap=True)


def print_status(
    console: Console, tasks: list[Task], store: Store, out: Path, workers: int | None
) -> None:
    """One line a stage: done, running, failed or to do, with its time; then what they all took.

    Args:
        workers: how many tasks ran side by side; None if `tasks` are a part of the study only.
    """
    busy = is_locked(out)
    table = Table(title=f"{out}{' (a run is going on)' if busy else ''}", box=SIMPLE)
    for column in ("stage", "for", "state"):
        table.add_column(column, no_wrap=True)
    table.add_column("seconds", justify="right")
    total = 0.0
    for task in tasks:
        state, seconds = _state(task, store, busy)
        total += seconds or 0.0
        table.add_row(task.stage, task.label, state, _number(seconds, 1))
    table.add_section()
    table.add_row("all", "", "", f"{total:.1f}")
    console.print(table)
    timings = [(task.stage, store.timing(task)) for task in tasks]
    console.print(usage.by_stage(timings))
    if workers and (line := usage.in_all([timing for _, timing in timings], workers)):
        console.print(line, soft_wrap=True)


def last_workers(config: Config, out: Path) -> int:
    """How many tasks ran side by side, in the run that published the results."""
    try:
        return int(read_json(out / TIMINGS)["workers"])
    except (OSError, ValueError, KeyError, TypeError):
        return workers(config.engine)


def write_timings(tasks: Iterable[Task], store: Store, config: Config, out: Path) -> None:
    """``timings.json``: what each stage took, on what, and how the stages were run.

    Seconds of wall time and of CPU time, and the peak of memory in bytes, where they are known.
    These differ from run to run, so they are not part of ``study.json``.
    """
    timings = {task.name: store.timing(task) for task in tasks}

    def each(quantity: str, digits: int | None = None) -> dict[str, float]:
        found = {name: timing.get(quantity) for name, timing in timings.items()}
        return {name: round(value, digits) for name, value in found.items() if value is not None}

    write_json(
        out / TIMINGS,
        {
            "finished": datetime.now(UTC).isoformat(timespec="seconds"),
            "machine": f"{platform.system()} {platform.machine()}",
            "engine": asdict(config.engine),
            "workers": workers(config.engine),
            "seconds": each("seconds", 3),
            "cpu_seconds": each("cpu_seconds", 3),
            "peak_memory": each("peak_memory"),
        },
    )


def _state(task: Task, store: Store, busy: bool) -> tuple[str, float | None]:
    seconds = store.timing(task).get("seconds")
    if seconds is not None:
        return "done", float(seconds)
    if busy and store.progress(task).exists():
        progress = read_progress(store.progress(task))
        return f"running {progress.get('fraction', 0.0):.0%} {progress.get('message', '')}", None
    if store.failure(task).exists():
        return f"failed: {store.failure(task).read_text().strip()}", None
    return "to do", None


def _overall(path: Path) -> dict[tuple[str, str, str, int, str], float]:
    """The scores averaged over everything, by environment, level, model, seed and metric."""
    if not path.exists():
        return {}
    scores = pd.read_parquet(path)
    rows = scores[(scores.dimension == "all") & (scores.step == -1) & (scores.scenario == -1)]
    keys = zip(rows.environment, rows.level, rows.model, rows.seed, rows.metric, strict=True)
    return dict(zip(keys, rows.value, strict=True))


def _value(scores: dict[Any, float], cell: Cell, metric: str) -> float | None:
    return scores.get((cell.environment, cell.level, cell.model, cell.seed, metric))


def _beta(record: Task, store: Store) -> str:
    if "trained" not in record.inputs:
        return ""
    try:
        beta = read_json(store.folder(record.inputs["trained"]) / "fit.json")["beta"]
    except (OSError, ValueError, KeyError):
        return "–"
    return "" if beta is None else f"{beta:.2g}"


def _number(value: float | None, digits: int) -> str:
    if value is None:
        return ""
    return f"{value:.{digits}f}" if np.isfinite(value) else str(value)
