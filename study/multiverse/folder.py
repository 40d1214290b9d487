"""The files of a multiverse: ``multiverse.json`` and three tables."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from study.common.errors import BadInput, StudyError
from study.common.files import read_json, replacing, write_json
from study.config.convert import by_dotted_name
from study.multiverse.design import Choice, Design, Exclusion, Universe

FORMAT = 2
FACTS = "multiverse.json"
EFFECTS, CELLS, REPEATS = "effects.parquet", "cells.parquet", "repeats.parquet"
FILES = (FACTS, EFFECTS, CELLS, REPEATS)
"""All results. Pages, figures and the recording are made from them."""
REUSED = "reused"
"""The entry of the facts with the universes whose results were taken from another multiverse: for
each, the versions of packages there that differ from those of the run."""
AGAIN = "run `python -m study.run multiverse` first, or name another folder"


@dataclass(frozen=True)
class Failure:
    """A stage that failed, with a cell that has no scores for this reason."""

    universe: str
    cell: str
    stage: str
    error: str


@dataclass(frozen=True)
class Multiverse:
    """All results of a multiverse.

    Attributes:
        design: the choices.
        universes: all universes of the design, run or not.
        effects: the effects of the claims, see `study.multiverse.effects`.
        cells: a row for each cell of each universe, with its mean scores, β and KL divergence.
        repeats: the same for the base readings with further training seeds.
        failures: the cells without scores because a stage failed.
        facts: settings that all universes share, versions, and maybe `REUSED`.
    """

    design: Design
    universes: Sequence[Universe]
    effects: pd.DataFrame
    cells: pd.DataFrame
    repeats: pd.DataFrame
    failures: Sequence[Failure]
    facts: Mapping[str, Any]

    @property
    def scored(self) -> list[str]:
        """The names of the universes that have scores."""
        present = set(self.cells["universe"])
        return [universe.name for universe in self.universes if universe.name in present]

    @property
    def values(self) -> dict[str, Mapping[str, str]]:
        """The values of every universe."""
        return {universe.name: universe.values for universe in self.universes}

    def settings(self, universe: Universe) -> dict[str, Any]:
        """The settings of a universe by dotted name, without the further seeds."""
        shared = by_dotted_name(self.facts["settings"])
        return shared | self.design.settings(universe.values)


def facts_of(multiverse: Multiverse) -> dict[str, Any]:
    """The content of ``multiverse.json``: all but the tables."""
    design = multiverse.design
    return {
        "format": FORMAT,
        # The order of choices, of their values, and of the base readings counts.
        "choices": [
            {
                "name": choice.name,
                "question": choice.question,
                "values": [{"name": n, "settings": s} for n, s in choice.values.items()],
            }
            for choice in design.choices
        ],
        "bases": [{"name": name, "values": values} for name, values in design.bases.items()],
        "exclusions": [asdict(rule) for rule in design.exclusions],
        "random": design.random,
        "seed": design.seed,
        "further_seeds": list(design.further_seeds),
        "universes": [asdict(universe) for universe in multiverse.universes],
        "failures": [asdict(failure) for failure in multiverse.failures],
        **multiverse.facts,
    }


def write(multiverse: Multiverse, out: Path) -> list[Path]:
    """Write the files.

    Returns:
        their paths.
    """
    write_json(out / FACTS, facts_of(multiverse), sort_keys=False)
    tables = {
        EFFECTS: multiverse.effects,
        CELLS: multiverse.cells,
        REPEATS: multiverse.repeats,
    }
    for name, table in tables.items():
        with replacing(out / name) as temporary:
            table.to_parquet(temporary, index=False)
    return [out / name for name in FILES]


def read(folder: Path) -> Multiverse:
    """Read the files.

    Raises:
        BadInput: the folder has no multiverse, or one of another version.
        StudyError: a file is damaged.
    """
    if not (folder / FACTS).is_file():
        raise BadInput(f"there is no multiverse in {folder}: {AGAIN}")
    try:
        facts = read_json(folder / FACTS)
        version = facts.pop("format")
        if version != FORMAT:
            raise BadInput(f"{folder / FACTS} has the format {version}, not {FORMAT}: {AGAIN}")
        choices = tuple(
            Choice(
                entry["name"],
                entry["question"],
                {value["name"]: value["settings"] for value in entry["values"]},
            )
            for entry in facts.pop("choices")
        )
        design = Design(
            choices,
            {entry["name"]: entry["values"] for entry in facts.pop("bases")},
            tuple(Exclusion(**rule) for rule in facts.pop("exclusions")),
            facts.pop("random"),
            facts.pop("seed"),
            tuple(facts.pop("further_seeds")),
        )
        universes = [Universe(**entry) for entry in facts.pop("universes")]
        failures = [Failure(**entry) for entry in facts.pop("failures")]
        effects, cells, repeats = (
            pd.read_parquet(folder / name) for name in (EFFECTS, CELLS, REPEATS)
        )
        for table in (effects, cells, repeats):
            table["universe"]
        facts = {**facts, "settings": dict(facts["settings"]), "versions": dict(facts["versions"])}
        if REUSED in facts:
            facts[REUSED] = {name: dict(other) for name, other in facts[REUSED].items()}
        for universe in universes:
            design.settings(universe.values)
        for failure in failures:
            hash(failure)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise StudyError(f"the multiverse in {folder} is damaged ({reason}): {AGAIN}") from None
    return Multiverse(design, universes, effects, cells, repeats, failures, facts)
