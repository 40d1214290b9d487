"""Cells side by side, from their recordings alone: settings that differ, and overall scores."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table

from study.common.errors import BadInput
from study.recording import reading
from study.recording.integrity import check

Value = str | int | float


def settings(path: Path) -> dict[str, Value]:
    """The settings that a recording carries, flat: `model`, `trained.train.steps` …

    Left out is what a stage's settings only repeat, and its seed, which follows from the cell.

    Raises:
        StudyError: the recording is missing or damaged.
    """
    found = reading.properties(path)
    try:
        config = json.loads(str(found.pop("config", "{}")))
    except ValueError:
        config = {}
    found.pop("cell", None)
    of_stages = _flat(config)
    repeated = [name for name in of_stages if name.rpartition(".")[2] in found]
    return found | {name: value for name, value in of_stages.items() if name not in repeated}


def overall_scores(path: Path) -> dict[str, float]:
    """The overall scores of a recording of scores: `mmd2`, `brier` …

    Those over all dimensions; of a metric that has no such number, those by dimension.

    Raises:
        StudyError: the recording is missing or damaged.
    """
    by_metric: dict[str, dict[str, float]] = {}
    for entity, frame in reading.scalars_below(path, "/overall").items():
        metric, dimension = (re.sub(r"\\(.)", r"\1", part) for part in entity.split("/")[2:4])
        row = {str(name): float(value) for name, value in frame.iloc[-1].items()}
        values = {dimension: row["value"]} if list(row) == ["value"] else row
        by_metric.setdefault(metric, {}).update(values)
    scores = {}
    for metric, values in by_metric.items():
        if "all" in values:
            scores[metric] = values["all"]
        else:
            scores |= {f"{metric} {dimension}": value for dimension, value in values.items()}
    return scores


def compare(paths: Mapping[str, Path]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Settings that differ, and overall scores: a column a cell; NaN where a cell has none.

    Args:
        paths: each cell's recording of scores, by the cell's name.

    Raises:
        BadInput: there are fewer than two cells.
        StudyError: a recording is missing or damaged.
    """
    if len(paths) < 2:
        raise BadInput("compare needs two cells or more, which differ")
    for path in paths.values():
        check(path)
    given = _side_by_side({cell: settings(path) for cell, path in paths.items()})
    differ = given.astype(str).nunique(axis=1) > 1
    scores = _side_by_side({cell: overall_scores(path) for cell, path in paths.items()})
    return given[differ], scores


def print_comparison(console: Console, differing: pd.DataFrame, scores: pd.DataFrame) -> None:
    """Print what `compare` has found as two tables."""
    _print(console, "settings that differ", differing)
    _print(console, "overall scores", scores)


def _print(console: Console, title: str, frame: pd.DataFrame) -> None:
    if frame.empty:
        console.print(f"{title}: none")
        return
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    table.add_column("")
    for cell in frame.columns:
        table.add_column(str(cell), justify="right", overflow="fold")
    for name, row in zip(frame.index, frame.to_numpy(dtype=object), strict=True):
        table.add_row(str(name), *map(_spell, row))
    console.print(table)
    console.print()


def _side_by_side(columns: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """Rows in the order in which they first occur."""
    rows = list(dict.fromkeys(name for column in columns.values() for name in column))
    table = {cell: [column.get(row) for row in rows] for cell, column in columns.items()}
    return pd.DataFrame(table, index=rows, dtype=object)


def _flat(tree: Any, prefix: str = "") -> dict[str, Value]:
    if not isinstance(tree, dict):
        return {prefix: tree if isinstance(tree, str | int | float) else json.dumps(tree)}
    leaves: dict[str, Value] = {}
    for name, branch in tree.items():
        leaves |= _flat(branch, f"{prefix}.{name}" if prefix else str(name))
    return leaves


def _spell(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
