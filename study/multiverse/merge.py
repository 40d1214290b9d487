"""Merge multiverses of one design that have results of different universes."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pandas as pd

from study.multiverse.folder import REUSED, Failure, Multiverse


def rows(table: pd.DataFrame, universe: str) -> pd.DataFrame:
    """The rows of one universe."""
    return table[table["universe"] == universe].reset_index(drop=True)


def merge(parts: Sequence[Multiverse]) -> Multiverse:
    """All results, in the order of the universes, with the facts of the first part.

    The results of a universe are those of the part with most of its cells, then with most cells of
    further seeds, then of the first such part. Universes share cells, so a part may have some cells
    of a universe that another part ran, and a universe that failed in one part may have run in
    another.

    Args:
        parts: multiverses with the same design and universes.
    """

    def extent(part: Multiverse, name: str) -> tuple[int, int]:
        return len(rows(part.cells, name)), len(rows(part.repeats, name))

    names = [universe.name for universe in parts[0].universes]
    owner = {name: max(parts, key=lambda part: extent(part, name)) for name in names}

    def merged(table: str) -> pd.DataFrame:
        of_each = (rows(getattr(part, table), name) for name, part in owner.items())
        return pd.concat(list(of_each), ignore_index=True)

    return replace(
        parts[0],
        effects=merged("effects"),
        cells=merged("cells"),
        repeats=merged("repeats"),
        failures=[failure for name in owner for failure in _failures(parts, owner[name], name)],
        facts=_facts(parts[0], owner),
    )


def _facts(first: Multiverse, owner: Mapping[str, Multiverse]) -> dict[str, Any]:
    """The facts of the first part, with the universes that were reused in any part."""
    facts = {name: value for name, value in first.facts.items() if name != REUSED}
    every = {name: part.facts.get(REUSED, {}) for name, part in owner.items()}
    reused = {name: of_part[name] for name, of_part in every.items() if name in of_part}
    return facts | ({REUSED: reused} if reused else {})


def _failures(parts: Sequence[Multiverse], owner: Multiverse, universe: str) -> list[Failure]:
    """The failures of a universe: those of its part, or of all parts if none has scores."""
    sources = [owner] if universe in owner.scored else parts
    found = (failure for part in sources for failure in part.failures)
    return list(dict.fromkeys(f for f in found if f.universe == universe))
