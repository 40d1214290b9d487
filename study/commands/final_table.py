"""The table at the end of a run: β, the scores and the paper's score of every cell."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from study.claims.paper import BRIER
from study.commands.terminal import say, show
from study.common.files import read_json
from study.config.grid import Cell
from study.config.settings import Config
from study.workflow.scheduler import NOT_RUN
from study.workflow.store import Store
from study.workflow.task import Task

COLUMNS = ("β", "MMD²", "Brier", "oracle", "paper")
"""Columns of the table; those without an entry are left out."""

Scores = Mapping[tuple[str, str, str, int, str], float]
"""Scores by environment, level, model, seed and metric."""


def print_table(
    console: Console,
    config: Config,
    records: Mapping[Cell, Task],
    store: Store,
    errors: Mapping[Task, str],
    out: Path,
) -> None:
    """Print β, MMD² and plain Brier score of every cell, and the paths of the results.

    The lines below name errors, and cells with forecasts or training losses that are not finite.

    Args:
        console: the terminal.
        config: settings of the study.
        records: the last task of every cell.
        store: the folders of the tasks.
        errors: the error of every task that failed or was not run.
        out: the results folder.
    """
    scores = _overall_scores(out / "scores.parquet")
    title = f"{config.name}: MMD² and plain Brier scores (lower is better)"
    table = Table(title=title, box=SIMPLE, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("cell")
    lines = {}
    for cell, record in records.items():
        mmd2, brier = (_score(scores, cell, metric) for metric in ("mmd2", "brier"))
        oracle = Cell(cell.environment, cell.level, "oracle", cell.seed)
        lines[cell.name] = (
            "failed" if record in errors and brier is None else _beta(record, store),
            number(mmd2, 4),
            number(brier, 3),
            number(_score(scores, oracle, "brier"), 3),
            number(BRIER.get((cell.environment, cell.level, cell.model)), 3),
        )
    # A recorded system has no oracle and no score in the paper.
    filled = [any(column) for column in zip(*lines.values(), strict=True)]
    for name, is_filled in zip(COLUMNS, filled, strict=False):
        if is_filled:
            table.add_column(name, justify="right")
    for name, entries in lines.items():
        table.add_row(name, *(e for e, is_filled in zip(entries, filled, strict=True) if is_filled))
    show(console, table)
    for line in not_finite(scores, records, store):
        say(console, line)
    for name in ("claims.md", "tables", "figures", "recordings"):
        say(console, f"{name.removesuffix('.md'):11} {out / name}")
    for task, error in errors.items():
        say(console, f"FAILED {task.name}: {error}{_log(task, error, store)}")


def not_finite(scores: Scores, records: Mapping[Cell, Task], store: Store) -> list[str]:
    """A sentence for each cell with forecasts, and each fit with losses, that are not finite."""
    lines = []
    for cell in records:
        share = _score(scores, cell, "nonfinite")
        if share:
            per_cent = f"{100 * share:.1f} %" if share >= 0.001 else "less than 0.1 %"
            lines.append(f"{cell.name}: {per_cent} of its forecast values are not finite")
    inputs = [(name, task) for record in records.values() for name, task in record.inputs.items()]
    fits = dict.fromkeys(task for name, task in inputs if name in ("ensemble", "trained"))
    counts = {fit: _losses_not_finite(store.folder(fit) / "metrics.csv") for fit in fits}
    return lines + [
        f"{fit.name}: {count} of its logged losses are not finite"
        for fit, count in counts.items()
        if count
    ]


def _losses_not_finite(curves: Path) -> int:
    """The number of values of training curves that are not finite; 0 without curves."""
    if not curves.is_file():
        return 0
    lines = curves.read_text(encoding="utf-8").splitlines()[1:]
    # Lightning leaves an entry empty where a curve has no value.
    entries = [entry for line in lines for entry in line.split(",") if entry]
    return sum(not np.isfinite(float(entry)) for entry in entries)


def number(value: float | None, digits: int) -> str:
    """A number with `digits` decimals; empty for None."""
    if value is None:
        return ""
    return f"{value:.{digits}f}" if np.isfinite(value) else str(value)


def _log(task: Task, error: str, store: Store) -> str:
    """The path of a failed task's log. A task that was not run may have an old log."""
    path = store.log(task)
    return f"  log: {path}" if path.is_file() and not error.startswith(NOT_RUN) else ""


def _overall_scores(path: Path) -> Scores:
    """Scores aggregated over dimensions, steps and scenarios."""
    if not path.exists():
        return {}
    scores = pd.read_parquet(path)
    rows = scores[(scores.dimension == "all") & (scores.step == -1) & (scores.scenario == -1)]
    keys = zip(rows.environment, rows.level, rows.model, rows.seed, rows.metric, strict=True)
    return dict(zip(keys, rows.value, strict=True))


def _score(scores: Scores, cell: Cell, metric: str) -> float | None:
    return scores.get((cell.environment, cell.level, cell.model, cell.seed, metric))


def _beta(record: Task, store: Store) -> str:
    if "trained" not in record.inputs:
        return ""
    try:
        beta: Any = read_json(store.folder(record.inputs["trained"]) / "fit.json")["beta"]
    except (OSError, ValueError, KeyError):
        return "–"
    return "" if beta is None else f"{beta:.2g}"
