"""Join multiverses of one design that ran different universes, such as on two machines.

The result is that of a single run of all these universes.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from study.common.errors import BadInput
from study.common.files import read_json
from study.multiverse import folder
from study.multiverse.folder import FACTS, Multiverse
from study.results import join as studies
from study.results import multiverse

OWN = ("failures", "settings.name")
"""Entries of ``multiverse.json`` that may differ."""


def join(folders: Sequence[Path], out: Path) -> None:
    """Write the multiverse of all universes of `folders`. The folder `out` appears when complete.

    Raises:
        BadInput: there are fewer than two folders, or their multiverses differ in their design,
            settings or versions, or have scores of the same universe, or `out` exists.
        StudyError: a folder is damaged.
    """
    studies.check_folders(folders, out)
    parts = [folder.read(path) for path in folders]
    _check_same_design(folders)
    _check_disjoint(folders, parts)
    studies.check_checksums(folders, multiverse.present)
    with studies.appearing(out) as partial:
        joined = _joined(parts)
        folder.write(joined, partial)
        multiverse.render(joined, partial)


def _check_same_design(folders: Sequence[Path]) -> None:
    first, *others = (read_json(path / FACTS) for path in folders)
    for path, other in zip(folders[1:], others, strict=True):
        found = studies.differences(_by_place(first), _by_place(other))
        if different := [name for name in found if not name.startswith(OWN)]:
            raise BadInput(f"join: {folders[0]} and {path} differ in {', '.join(different)}")


def _by_place(facts: dict[str, Any]) -> dict[str, Any]:
    """The facts without lists of entries: an entry that has a name is found by it."""

    def named(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: named(entry) for name, entry in value.items()}
        if isinstance(value, list) and all(isinstance(e, dict) and "name" in e for e in value):
            return {entry["name"]: named(entry) for entry in value}
        return value

    return {name: named(value) for name, value in facts.items()}


def _check_disjoint(folders: Sequence[Path], parts: Sequence[Multiverse]) -> None:
    owner: dict[str, Path] = {}
    for path, part in zip(folders, parts, strict=True):
        for name in part.scored:
            if name in owner:
                raise BadInput(f"join: {owner[name]} and {path} both have the universe {name}")
            owner[name] = path


def _joined(parts: Sequence[Multiverse]) -> Multiverse:
    """All results, in the order of the universes."""
    first = parts[0]
    names = [universe.name for universe in first.universes]
    # Universes share cells, so a part may have some cells of a universe that another part ran. A
    # universe that failed in one part may have run in another.
    owner = {
        name: max(
            parts, key=lambda part: (name in part.scored, (part.repeats.universe == name).sum())
        )
        for name in names
    }
    scored = {name for part in parts for name in part.scored}
    failures = [
        failure
        for name in names
        for part in ([owner[name]] if name in scored else parts)
        for failure in part.failures
        if failure.universe == name
    ]

    def rows(table: str) -> pd.DataFrame:
        tables = [(name, getattr(owner[name], table)) for name in names]
        return pd.concat(
            [rows[rows["universe"] == name] for name, rows in tables], ignore_index=True
        )

    return replace(
        first,
        effects=rows("effects"),
        cells=rows("cells"),
        repeats=rows("repeats"),
        failures=list(dict.fromkeys(failures)),
    )
