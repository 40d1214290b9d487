"""Take the results of universes from another multiverse, so that only those that it lacks run.

A results folder that was copied, such as the published one in a fresh clone, has no stages. There,
a design with a further value would run all its universes again. So a run can take those whose
settings and cells the other multiverse has, whatever their names.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from study.common.errors import BadInput
from study.config.grid import Cell
from study.config.settings import Config
from study.metrics.tables.table import CELL
from study.multiverse import folder
from study.multiverse.design import Universe
from study.multiverse.folder import Multiverse
from study.multiverse.merge import merge, owners, rows
from study.results import multiverse
from study.results.join import check_checksums
from study.results.multiverse import Tasks
from study.results.protection import differing_settings, dotted_settings

SEEDS = "grid.seeds"


@dataclass(frozen=True)
class Reusable:
    """The universes of a design whose results another multiverse has.

    Attributes:
        source: the other multiverse.
        names: the name of the universe there, by its name in the design.
    """

    source: Multiverse
    names: Mapping[str, str]


def find(path: Path, configs: Mapping[str, Config], tasks: Tasks) -> Reusable:
    """The universes of a design with the same settings and cells as one of another multiverse.

    Args:
        path: the folder of the other multiverse.
        configs: the settings of all universes of the design, by name.
        tasks: of all cells of these universes.

    Raises:
        BadInput: the folder has no multiverse, or no such universe.
        StudyError: the folder is damaged.
    """
    source = folder.read(path)
    check_checksums([path], multiverse.present)
    failed = {failure.universe for failure in source.failures}
    candidates = [u for u in source.universes if u.name in set(source.scored) - failed]
    cells = {universe.name: _cells(source, universe) for universe in candidates}
    settings = {universe.name: source.settings(universe) for universe in candidates}
    names: dict[str, str] = {}
    differing: list[str] | None = None
    for name, config in configs.items():
        own, expected = dotted_settings(config), {cell.name for cell in tasks[name]}
        for other in cells:
            different = _differing(settings[other], own)
            if not different and cells[other] == expected:
                names[name] = other
                break
            if other == name:
                differing = different or ["their cells"]
    if not names:
        reason = f"; the first differs in {', '.join(differing)}" if differing else ""
        raise BadInput(
            f"--reuse: no universe of {path} has the settings of one in this design{reason}"
        )
    return Reusable(source, names)


def add(collected: Multiverse, reusable: Reusable) -> Multiverse:
    """The collected results with those of the universes that have none of their own.

    ``multiverse.json`` names them, each with the versions that differ from those of the run.
    """
    part = _renamed(collected, reusable)
    parts = (collected, part)
    taken = [name for name, owner in owners(parts).items() if owner is part]
    facts = dict(collected.facts)
    if taken:
        facts["reused"] = {name: _other_versions(collected, reusable, name) for name in taken}
    return replace(merge(parts), facts=facts)


def _renamed(collected: Multiverse, reusable: Reusable) -> Multiverse:
    """The results of the other multiverse as those of universes of the design."""

    def table(name: str) -> pd.DataFrame:
        every = getattr(reusable.source, name)
        found = [rows(every, old).assign(universe=new) for new, old in reusable.names.items()]
        return pd.concat(found, ignore_index=True).astype(every.dtypes)

    return replace(
        collected,
        effects=table("effects"),
        cells=table("cells"),
        repeats=table("repeats"),
        failures=[],
    )


def _other_versions(collected: Multiverse, reusable: Reusable, name: str) -> dict[str, Any]:
    facts, old = reusable.source.facts, reusable.names[name]
    versions = {**facts["versions"], **facts.get("reused", {}).get(old, {})}
    own = collected.facts["versions"]
    return {key: value for key, value in versions.items() if own.get(key) != value}


def _differing(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """The settings that differ. Seeds are compared by the cells."""
    return [name for name in differing_settings(old, new) if name != SEEDS]


def _cells(source: Multiverse, universe: Universe) -> set[str]:
    """The names of the cells of a universe, with those of further seeds."""
    found = pd.concat([rows(t, universe.name) for t in (source.cells, source.repeats)])
    return {Cell(*row).name for row in found[list(CELL)].itertuples(index=False)}
