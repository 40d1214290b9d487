"""Join multiverses of one design that ran different universes, such as on two machines."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from study.common.errors import BadInput
from study.config.convert import by_dotted_name
from study.config.grid import Cell
from study.metrics.tables.table import CELL
from study.multiverse import folder
from study.multiverse.folder import REUSED, Multiverse
from study.multiverse.merge import merge, rows
from study.results import multiverse
from study.results.join import check_checksums, check_folders, different_names, whole_folder

MAY_DIFFER = ("failures", "settings.name", REUSED)
"""Beginnings of the names of entries of ``multiverse.json``."""


def join(folders: Sequence[Path], out: Path) -> None:
    """Write the multiverse of all universes of `folders`. The folder `out` appears when complete.

    Args:
        folders: the results folders.
        out: the results folder to write.

    Raises:
        BadInput: there are fewer than two folders, or their multiverses differ in their design,
            settings, versions, cells or the results of a universe that two have, or `out` exists.
        StudyError: a folder is damaged.
    """
    check_folders(folders, out)
    check_checksums(folders, multiverse.present)
    parts = [folder.read(path) for path in folders]
    for number, part in enumerate(parts):
        for path, earlier in zip(folders, parts[:number], strict=False):
            if different := _differences(earlier, part):
                raise BadInput(f"join: {path} and {folders[number]} differ in {different}")
    joined = merge(parts)
    with whole_folder(out) as partial:
        folder.write(joined, partial)
        multiverse.render(joined, partial)


def _differences(first: Multiverse, second: Multiverse) -> str:
    """What keeps two multiverses from being joined; empty if nothing does."""
    facts = (by_dotted_name(_named(folder.facts_of(part))) for part in (first, second))
    if names := [name for name in different_names(*facts) if not name.startswith(MAY_DIFFER)]:
        return ", ".join(names)
    if names := sorted(_cells(first) ^ _cells(second)):
        return f"their cells: only one has {', '.join(names)}"
    for name in second.scored:
        for table in ("effects", "cells"):
            old, new = (rows(getattr(part, table), name) for part in (first, second))
            if name in first.scored and not old.equals(new):
                return f"the results of the universe {name}"
    return ""


def _named(value: Any) -> Any:
    """Facts with a mapping by name in place of each list of named entries, and their order."""
    if isinstance(value, dict):
        return {name: _named(entry) for name, entry in value.items()}
    if isinstance(value, list) and all(isinstance(e, dict) and "name" in e for e in value):
        names = [entry["name"] for entry in value]
        return {"(order)": names, **{entry["name"]: _named(entry) for entry in value}}
    return value


def _cells(part: Multiverse) -> set[str]:
    """The names of the cells that have run, or failed, in any universe."""
    return {*cell_names(part.cells), *(failure.cell for failure in part.failures)}


def cell_names(table: pd.DataFrame) -> frozenset[str]:
    """The names of the cells in a table."""
    found = table[list(CELL)].drop_duplicates()
    return frozenset(Cell(*row).name for row in found.itertuples(index=False))
