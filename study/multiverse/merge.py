"""Merge multiverses of one design that have results of different universes."""

from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from study.multiverse.folder import Failure, Multiverse


def rows(table: pd.DataFrame, universe: str) -> pd.DataFrame:
    """The rows of one universe."""
    return table[table["universe"] == universe].reset_index(drop=True)


def owners(parts: Sequence[Multiverse]) -> dict[str, Multiverse]:
    """The part that gives the results of each universe: the one with the most, or the first.

    Universes share cells, so a part may have some cells of a universe that another part ran. A
    universe that failed in one part may have run in another.

    Args:
        parts: multiverses with the same universes.
    """

    def extent(part: Multiverse, name: str) -> tuple[bool, int]:
        return name in part.scored, len(rows(part.repeats, name))

    names = [universe.name for universe in parts[0].universes]
    return {name: max(parts, key=lambda part: extent(part, name)) for name in names}


def merge(parts: Sequence[Multiverse]) -> Multiverse:
    """All results, in the order of the universes, with the facts of the first part.

    Args:
        parts: multiverses with the same design and universes.
    """
    owner = owners(parts)

    def merged(table: str) -> pd.DataFrame:
        of_each = (rows(getattr(part, table), name) for name, part in owner.items())
        return pd.concat(list(of_each), ignore_index=True)

    return replace(
        parts[0],
        effects=merged("effects"),
        cells=merged("cells"),
        repeats=merged("repeats"),
        failures=[failure for name in owner for failure in _failures(parts, owner[name], name)],
    )


def _failures(parts: Sequence[Multiverse], owner: Multiverse, universe: str) -> list[Failure]:
    """The failures of a universe: those of its part, or of all parts if none has scores."""
    sources = [owner] if universe in owner.scored else parts
    found = (failure for part in sources for failure in part.failures)
    return list(dict.fromkeys(f for f in found if f.universe == universe))
