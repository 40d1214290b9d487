"""One study from several that were run apart, each with seeds of its own: on a cluster, or in turn.

It is what a single run of all seeds would have left: scores, claims, tables, figures and weights
have the same bytes.
"""

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from study.commands.status import TIMINGS
from study.common.errors import BadInput, StudyError
from study.common.files import copy, read_json, write_json
from study.config.grid import Cell, cells
from study.config.settings import Config
from study.results import checksums, publish
from study.results.folder import Stored, read, settings_of
from study.results.writable import check_writable, make

BY_STAGE = ("seconds", "cpu_seconds", "peak_memory")
OF_CELLS = ("recordings", "weights", "illustrations")


def join(folders: Sequence[Path], out: Path) -> None:
    """Write the study of all seeds of `folders` to `out`, which appears when it is complete.

    Raises:
        BadInput: fewer than two folders, studies that differ in more than their seeds or share one,
            or an `out` that is there already.
        StudyError: a folder is damaged.
    """
    if len(folders) < 2:
        raise BadInput("join: give at least two results folders")
    if out.exists():
        raise BadInput(f"--out: '{out}' is there already; give a folder that is not")
    check_writable(out)
    parts = [read(folder) for folder in folders]
    config = _of_all(parts)
    for part in parts:
        if problems := checksums.problems(part.out):
            raise StudyError(f"{problems[0]}; restore it, or run that study again")
    begun = out.with_name(f".{out.name}.new")
    shutil.rmtree(begun, ignore_errors=True)
    make(begun)
    try:
        _write(parts, config, begun)
        begun.replace(out)
    finally:
        shutil.rmtree(begun, ignore_errors=True)


def _of_all(parts: Sequence[Stored]) -> Config:
    """The settings of the whole: those of the first, with the seeds of all."""
    first = parts[0]
    for number, part in enumerate(parts):
        if different := _differing(first, part):
            raise BadInput(f"join: {first.out} and {part.out} differ in {', '.join(different)}")
        for earlier in parts[:number]:
            if shared := set(part.config.grid.seeds) & set(earlier.config.grid.seeds):
                names = ", ".join(map(str, sorted(shared)))
                raise BadInput(f"join: {earlier.out} and {part.out} both have seed {names}")
    seeds = tuple(sorted(seed for part in parts for seed in part.config.grid.seeds))
    return replace(first.config, grid=replace(first.config.grid, seeds=seeds))


def _differing(one: Stored, other: Stored) -> list[str]:
    """The settings and versions in which two studies differ, their seeds and names left out."""

    def flat(values: Any, name: str) -> dict[str, Any]:
        if not isinstance(values, dict):
            return {name: values}
        return {k: v for key in values for k, v in flat(values[key], f"{name}{key}.").items()}

    def told(part: Stored) -> dict[str, Any]:
        return flat(settings_of(part.config) | {"versions": part.versions}, "")

    first, second = told(one), told(other)
    names = sorted(first.keys() | second.keys())
    return [
        name.rstrip(".")
        for name in names
        if name not in ("grid.seeds.", "name.") and first.get(name) != second.get(name)
    ]


def _write(parts: Sequence[Stored], config: Config, out: Path) -> None:
    complete = {cell for part in parts for cell in part.complete}
    failed = {name for part in parts for name in read_json(part.out / "study.json")["failed"]}
    for part in parts:
        for folder in OF_CELLS:
            for path in sorted((part.out / folder).rglob("*")):
                if path.is_file() and path.name.split(".")[0] != "study":
                    copy(path, out / path.relative_to(part.out))
    grid = cells(config)
    whole = publish.Whole(
        config,
        [cell for cell in grid if cell in complete],
        [cell.name for cell in grid if cell.name in failed],
        _in_order(parts, publish.SCORES, grid),
        _in_order(parts, publish.TRIALS, grid),
        parts[0].versions,
    )
    publish.write_summary(whole, out)
    times = [read_json(part.out / TIMINGS) for part in parts]
    added = {key: {k: v for one in times for k, v in one[key].items()} for key in BY_STAGE}
    write_json(out / TIMINGS, times[0] | {"finished": max(t["finished"] for t in times)} | added)
    checksums.write(out)


def _in_order(parts: Sequence[Stored], name: str, grid: Sequence[Cell]) -> pd.DataFrame:
    """The rows of all parts, cell after cell in the order of the grid."""
    rows = pd.concat([pd.read_parquet(part.out / name) for part in parts], ignore_index=True)
    place = pd.Series({cell.name: index for index, cell in enumerate(grid)})
    names = rows.environment + "/" + rows.level + "/" + rows.model
    order = (names + "/seed-" + rows.seed.astype(str)).map(place).argsort(kind="stable")
    return rows.iloc[order].reset_index(drop=True)
