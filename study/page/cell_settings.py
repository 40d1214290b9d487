"""The settings in which cells differ, from the properties of their recordings."""

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from study.common.errors import StudyError
from study.config.convert import by_dotted_name
from study.page.evidence import Evidence
from study.page.settings_view import shown
from study.page.tables import Table, text
from study.recording.reading import read_properties

KIND = "scores.rrd"
TRIVIAL = ("seed", "environment", "model", "level")
"""The last parts of the names of settings that follow from the name of the cell."""


def table(evidence: Evidence) -> Table | None:
    """One row for each value of a setting that is not the same in all cells."""
    by_cell = {
        cell: settings
        for cell, path in _paths(evidence.recordings)
        if (settings := _settings(evidence, path))
    }
    rows = []
    for name in sorted({name for settings in by_cell.values() for name in settings}):
        cells_of: dict[str, list[str]] = {}
        for cell, settings in by_cell.items():
            if name in settings:
                cells_of.setdefault(shown(settings[name]), []).append(cell)
        if len(cells_of) > 1:
            with_setting = [cell for cells in cells_of.values() for cell in cells]
            rows += [
                [text(name), text(value), text(", ".join(patterns(cells, with_setting)))]
                for value, cells in cells_of.items()
            ]
    if not rows:
        return None
    notes = [
        f"From the recordings of {len(by_cell)} cells. A pattern is about the cells that have the "
        "setting."
    ]
    caption = "Settings in which cells differ"
    heads = ["setting", "value", "cells"]
    return Table("settings-of-cells", caption, heads, rows, notes=notes, tools=True)


def patterns(cells: Sequence[str], every: Iterable[str]) -> list[str]:
    """Short patterns that match some cells and no others.

    >>> every = ["uav/low/vae/seed-0", "uav/low/vae/seed-1", "uav/high/vae/seed-0"]
    >>> patterns(every[:2], every)
    ['*/low/*/*']
    """
    others = set(every) - set(cells)
    left, found = list(cells), []
    while left:
        parts = left[0].split("/")
        for position in reversed(range(len(parts))):
            wider = [*parts[:position], "*", *parts[position + 1 :]]
            if not any(_matches(name, wider) for name in others):
                parts = wider
        found.append("/".join(parts))
        left = [name for name in left if not _matches(name, parts)]
    return found


def _matches(name: str, pattern: Sequence[str]) -> bool:
    parts = name.split("/")
    return len(parts) == len(pattern) and all(
        wanted in ("*", part) for part, wanted in zip(parts, pattern, strict=True)
    )


def _paths(recordings: Iterable[str]) -> Iterable[tuple[str, str]]:
    for path in recordings:
        folder, _, kind = path.removeprefix("recordings/").rpartition("/")
        if kind == KIND:
            yield folder, path


def _settings(evidence: Evidence, path: str) -> Mapping[str, Any]:
    """The settings of a cell by dotted name; empty if its recording is damaged."""
    try:
        stages = json.loads(read_properties(evidence.out / path).get("config", "{}"))
        values = by_dotted_name(stages)
    except (StudyError, ValueError, AttributeError):
        return {}
    return {name: v for name, v in values.items() if name.split(".")[-1] not in TRIVIAL}
