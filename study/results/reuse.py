"""Take the results of universes from another multiverse, so that only those that it lacks run.

A results folder that was copied, such as the published one in a fresh clone, has no stages. There,
a run of a design with a further value would run all universes again. Here it takes the results of
each universe that has the same settings and cells in the other multiverse. The names of the two
universes may differ. The code of the study is not compared.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from study.claims.judge import CLAIMS
from study.common.errors import BadInput, StudyError
from study.config.grid import cells
from study.config.recorded import recorded_of
from study.config.settings import Config
from study.multiverse import folder
from study.multiverse.design import Design
from study.multiverse.folder import REUSED, Multiverse
from study.multiverse.merge import merge, rows
from study.results import multiverse
from study.results.folder import STUDY
from study.results.join import check_checksums
from study.results.join_multiverse import cell_names
from study.results.protection import differing_settings, dotted_settings

SEEDS = "grid.seeds"
Cells = tuple[frozenset[str], frozenset[str]]
"""The names of the cells from which claims are judged, and of those with further seeds."""


@dataclass(frozen=True)
class Reusable:
    """The universes of a design whose results another multiverse has.

    Attributes:
        source: the other multiverse.
        names: the name of the universe there, by its name in the design.
    """

    source: Multiverse
    names: Mapping[str, str]


def find(path: Path, config: Config, design: Design, configs: Mapping[str, Config]) -> Reusable:
    """The universes of a design with the same settings and cells as one of another multiverse.

    Args:
        path: the folder of the other multiverse.
        config: the settings that all universes of the design share.
        design: the choices.
        configs: the settings of all universes of the design, by name.

    Raises:
        BadInput: the folder has no multiverse, or no such universe, or systems or models are not
            those of this study.
        StudyError: the folder is damaged.
    """
    source = _read(path)
    _check_own(config, source)
    failed = {failure.universe for failure in source.failures}
    others = [u for u in source.universes if u.name in set(source.scored) - failed]
    settings = {universe.name: source.settings(universe) for universe in others}
    there = {name: _cells_of(source, name) for name in settings}
    further = set(design.further_seeds) - set(config.grid.seeds)
    names: dict[str, str] = {}
    example = ""
    for name, own in configs.items():
        expected, dotted = _expected(own, further), dotted_settings(own)
        for other in settings:
            different = _differing(settings[other], dotted)
            if not different and there[other] == expected:
                names[name] = other
                break
            if other == name and not example:
                example = f"; '{name}' differs in {', '.join(different) or 'its cells or seeds'}"
    if not names:
        raise BadInput(
            f"--reuse: no universe of {path} has the settings and cells of one in this design"
            f"{example}"
        )
    return Reusable(source, names)


def _read(path: Path) -> Multiverse:
    """The other multiverse, after a check of its files."""
    if (path / STUDY).is_file():
        raise BadInput(f"--reuse: {path} has a study, not a multiverse")
    try:
        source = folder.read(path)
        check_checksums([path], multiverse.present)
    except StudyError as error:
        raise type(error)(f"--reuse: {error}") from None
    if set(source.effects["claim"]) - {claim.id for claim in CLAIMS}:
        raise BadInput(f"--reuse: {path} is of a version with other claims")
    return source


def _check_own(config: Config, source: Multiverse) -> None:
    """Check that systems and models are those of this study.

    Raises:
        BadInput: there are plugins or recorded systems, whose code and logs are not compared.
    """
    if plugins := {*config.plugins, *source.facts["settings"].get("plugins", ())}:
        listed = ", ".join(sorted(plugins))
        raise BadInput(f"--reuse: the code of plugins is not compared ({listed}); leave it out")
    for environment in config.grid.environments:
        if recorded_of(config, environment) is not None:
            raise BadInput(f"--reuse: the logs of {environment} are not compared; leave it out")


def add(collected: Multiverse, reusable: Reusable) -> Multiverse:
    """The collected results, and those of the universes that have fewer or none of their own."""
    return merge([collected, _renamed(collected, reusable)])


def _renamed(collected: Multiverse, reusable: Reusable) -> Multiverse:
    """The results of the other multiverse as those of universes of the design."""

    def table(name: str) -> pd.DataFrame:
        every = getattr(reusable.source, name)
        found = [rows(every, old).assign(universe=new) for new, old in reusable.names.items()]
        return pd.concat(found, ignore_index=True).astype(every.dtypes)

    reused = {name: _other_versions(collected, reusable, name) for name in reusable.names}
    return replace(
        collected,
        effects=table("effects"),
        cells=table("cells"),
        repeats=table("repeats"),
        failures=[],
        facts={**collected.facts, REUSED: reused},
    )


def _other_versions(collected: Multiverse, reusable: Reusable, name: str) -> dict[str, Any]:
    """The versions with which a universe was run, where they differ from those of this run."""
    facts, old = reusable.source.facts, reusable.names[name]
    versions = {**facts["versions"], **facts.get(REUSED, {}).get(old, {})}
    own = collected.facts["versions"]
    return {key: value for key, value in versions.items() if own.get(key) != value}


def _differing(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """The settings that differ. Seeds are compared by the cells."""
    return [name for name in differing_settings(old, new) if name != SEEDS]


def _expected(config: Config, further: set[int]) -> Cells:
    """The cells that the settings of a universe have."""
    every = cells(config)
    return (
        frozenset(cell.name for cell in every if cell.seed not in further),
        frozenset(cell.name for cell in every if cell.seed in further),
    )


def _cells_of(source: Multiverse, universe: str) -> Cells:
    """The cells that have scores in a universe."""
    return cell_names(rows(source.cells, universe)), cell_names(rows(source.repeats, universe))
