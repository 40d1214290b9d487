"""Join studies with different seeds into one study.

The result is that of a single run of all seeds: scores, claims, tables, figures and weights have
the same bytes.
"""

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from study.common.errors import BadInput, StudyError
from study.common.files import copy, read_json
from study.config.convert import by_dotted_name
from study.config.grid import Cell, cells
from study.config.settings import Config
from study.results import checksums, origin, summary, timings
from study.results.folder import (
    STUDY,
    STUDY_RECORDING,
    Results,
    check_writable,
    create,
    read,
    settings_of,
)
from study.results.publish import CELL_FOLDERS


def join(folders: Sequence[Path], out: Path) -> None:
    """Write the study of all seeds of `folders`. The folder `out` appears when it is complete.

    Raises:
        BadInput: there are fewer than two folders, or their studies differ in more than their seeds
            or share a seed, or `out` exists.
        StudyError: a folder is damaged.
    """
    check_folders(folders, out)
    parts = [read(folder) for folder in folders]
    config = _joined_config(parts)
    check_checksums(folders)
    with whole_folder(out) as partial:
        _write(parts, config, partial)


def check_folders(folders: Sequence[Path], out: Path) -> None:
    """Check that there is something to join, and a place for the result.

    Args:
        folders: the results folders.
        out: the results folder to write.

    Raises:
        BadInput: there are fewer than two folders, or `out` exists or cannot be written.
    """
    if len(folders) < 2:
        raise BadInput(f"join: got {len(folders)} results folder; give at least two")
    if out.exists():
        raise BadInput(f"--out: '{out}' exists; give a folder that does not")
    check_writable(out)


def check_checksums(
    folders: Sequence[Path], present: Callable[[Path], list[str]] = checksums.present
) -> None:
    """Check all files of all folders.

    Args:
        folders: the results folders.
        present: the names of the files of a folder that have checksums.

    Raises:
        StudyError: names the first file that is damaged or missing.
    """
    for folder in folders:
        if problems := checksums.problems(folder, present(folder)):
            raise StudyError(f"{problems[0]}; restore it, or write that folder again")


@contextmanager
def whole_folder(out: Path) -> Iterator[Path]:
    """A results folder that appears when it is complete.

    Args:
        out: the folder.

    Yields:
        a hidden folder to write to. It becomes `out` at the end, and is removed after an error.

    Raises:
        BadInput: the folder cannot be created.
    """
    # A killed run may have left this hidden folder, since its name is always the same.
    partial = out.with_name(f".{out.name}.new")
    shutil.rmtree(partial, ignore_errors=True)
    create(partial)
    try:
        yield partial
        partial.replace(out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def different_names(first: Mapping[str, Any], second: Mapping[str, Any]) -> list[str]:
    """The sorted names of the entries in which two mappings differ."""
    return [
        name for name in sorted(first.keys() | second.keys()) if first.get(name) != second.get(name)
    ]


def _joined_config(parts: Sequence[Results]) -> Config:
    """The settings of the first study, with the seeds of all studies."""
    first = parts[0]
    for number, part in enumerate(parts):
        if different := _different_settings(first, part):
            raise BadInput(f"join: {first.out} and {part.out} differ in {', '.join(different)}")
        for earlier in parts[:number]:
            if shared := set(part.config.grid.seeds) & set(earlier.config.grid.seeds):
                names = ", ".join(map(str, sorted(shared)))
                raise BadInput(f"join: {earlier.out} and {part.out} both have seed {names}")
    seeds = tuple(sorted(seed for part in parts for seed in part.config.grid.seeds))
    return replace(first.config, grid=replace(first.config.grid, seeds=seeds))


def _different_settings(first: Results, second: Results) -> list[str]:
    """The settings and versions in which two studies differ, except their seeds and names."""
    a, b = (
        by_dotted_name(settings_of(part.config) | {"versions": dict(part.origin.versions)})
        for part in (first, second)
    )
    return [name for name in different_names(a, b) if name not in ("grid.seeds", "name")]


def _write(parts: Sequence[Results], config: Config, out: Path) -> None:
    complete = {cell for part in parts for cell in part.complete}
    failed = {name for part in parts for name in read_json(part.out / STUDY)["failed"]}
    for part in parts:
        study_recording = part.out / STUDY_RECORDING
        for folder in CELL_FOLDERS:
            for path in sorted((part.out / folder).rglob("*")):
                if path.is_file() and not path.name.startswith(study_recording.name):
                    copy(path, out / path.relative_to(part.out))
    grid, problem = cells(config), None
    try:
        summary.write(
            summary.Summary(
                config,
                [cell for cell in grid if cell in complete],
                [cell.name for cell in grid if cell.name in failed],
                _read_rows(parts, summary.SCORES, grid),
                _read_rows(parts, summary.TRIALS, grid),
                _read_fits(parts, grid),
                origin.join(part.origin for part in parts),
            ),
            out,
        )
    except StudyError as error:  # a figure could not be drawn; all other files are written
        problem = error
    timings.join([part.out for part in parts], out)
    checksums.write(out)
    if problem is not None:
        raise problem


def _read_fits(parts: Sequence[Results], grid: Sequence[Cell]) -> pd.DataFrame:
    """``fits.parquet`` of all parts. A study that was made before this file existed has no rows."""
    parts = [part for part in parts if (part.out / summary.FITS).is_file()]
    return _read_rows(parts, summary.FITS, grid) if parts else summary.fits_table([])


def _read_rows(parts: Sequence[Results], name: str, grid: Sequence[Cell]) -> pd.DataFrame:
    """The rows of a table of all parts, in the order of the cells of the grid."""
    rows = pd.concat([pd.read_parquet(part.out / name) for part in parts], ignore_index=True)
    position = pd.Series({cell.name: index for index, cell in enumerate(grid)})
    names = rows.environment + "/" + rows.level + "/" + rows.model
    order = (names + "/seed-" + rows.seed.astype(str)).map(position).argsort(kind="stable")
    return rows.iloc[order].reset_index(drop=True)
