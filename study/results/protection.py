"""Protection of results that neither a run nor ``work/`` can compute again.

A results folder that was copied or joined has no ``work/``. A run of some of its cells, or with
other settings, would replace its scores, weights and recordings. So such a run is refused.
"""

import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from study.common.files import read_json
from study.common.provenance import MANIFEST
from study.config.convert import by_dotted_name
from study.config.grid import Cell
from study.config.names import ORACLE
from study.config.settings import Config
from study.config.tree import known_settings
from study.results.folder import STUDY, settings_of
from study.workflow.store import Store

NAMED = 6
"""Largest number of names in an error."""
PATTERNS = ("weights/*/*/*/seed-*.safetensors", "recordings/*/*/*/seed-*")
"""Patterns of the files of a cell in a results folder."""
WITHOUT_EFFECT = ("name", "plugins", "ablations", "publish.")
"""Settings, and prefixes of settings, on which the numbers of a cell do not depend."""
OF_SOME_CELLS = ("grid.", "model.")
"""Prefixes of settings that may concern only cells outside a study."""


def why_refused(config: Config, computed: Collection[Cell], store: Store, out: Path) -> str | None:
    """Why a run must not publish its results in a folder; None if it may.

    Args:
        config: settings of the run.
        computed: the cells that the run computes, or has computed.
        store: the folders of the tasks. A cell that was evaluated there can be published again.
        out: the results folder.
    """
    evaluated = _evaluated(store)
    lost = {name for name in _published(out) if evaluated.isdisjoint(_labels(name))}
    if not lost:
        return None
    differing = _different_settings(config, out)
    if not differing:
        lost -= {cell.name for cell in computed}
    if not lost:
        return None
    return would_be_lost(sorted(lost), differing, out)


def would_be_lost(names: Sequence[str], differing: Sequence[str], out: Path) -> str:
    """The error that a run would replace results that it cannot compute again.

    Args:
        names: of the cells or universes.
        differing: the settings that differ from those of the results.
        out: the results folder.
    """
    listed = ", ".join(names[:NAMED])
    if len(names) > NAMED:
        listed += f" and {len(names) - NAMED} more"
    reason = f" (settings differ: {', '.join(differing[:NAMED])})" if differing else ""
    return f"the results of {listed} would be lost, since {out} has no work/ of them{reason}"


def _published(out: Path) -> set[str]:
    """Names of the cells that have results in a folder, by its ``study.json`` and its files."""
    paths = [path for pattern in PATTERNS for path in out.glob(pattern)]
    names = {"/".join(path.with_suffix("").relative_to(out).parts[1:]) for path in paths}
    facts = _study(out)
    return names | {str(name) for name in facts.get("cells", [])}


def _evaluated(store: Store) -> set[str]:
    """The labels of the tasks `evaluate` in the store, with any settings."""
    labels = set()
    for path in (store.root / "evaluate").glob(f"*/{MANIFEST}"):
        try:
            labels.add(str(read_json(path)["label"]))
        except (OSError, ValueError, KeyError, TypeError):
            continue
    return labels


def _labels(name: str) -> set[str]:
    """The labels that the task `evaluate` of a cell may have.

    All levels share the task of the oracle. In earlier versions its label was without the seed.
    """
    parts = name.split("/")
    if ORACLE not in parts:
        return {name}
    return {f"{parts[0]}/{ORACLE}/{parts[-1]}", f"{parts[0]}/{ORACLE}"}


def _different_settings(config: Config, out: Path) -> list[str]:
    """The settings that change numbers and differ from those of the results in a folder."""
    settings = _study(out).get("settings")
    if not isinstance(settings, dict):
        return ["all, since study.json cannot be read"]
    old, new = by_dotted_name(settings), dotted_settings(config)
    return [
        name
        for name in differing_settings(old, new)
        if not (name.startswith(OF_SOME_CELLS) and _only_other_cells(name, old, new))
    ]


def dotted_settings(config: Config) -> dict[str, Any]:
    """The settings by dotted name, with the types that JSON has."""
    return by_dotted_name(json.loads(json.dumps(settings_of(config))))


def differing_settings(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """The sorted names of the settings that change numbers and differ.

    Args:
        old: settings by dotted name. A setting that was added later has its default.
        new: others.
    """
    known = known_settings()

    def value(settings: Mapping[str, Any], name: str) -> Any:
        later = name in known and known[name].was_added_later
        return settings.get(name, known[name].default if later else None)

    return [
        name
        for name in sorted(old.keys() | new.keys())
        if not name.startswith(WITHOUT_EFFECT) and value(old, name) != value(new, name)
    ]


def _only_other_cells(name: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> bool:
    """Whether a setting only defines the grid, or concerns cells that one of the studies lacks."""
    return not name.startswith(("grid.levels.", "model.")) or name not in old or name not in new


def _study(out: Path) -> dict[str, Any]:
    """The content of ``study.json``; empty if the file is missing or damaged."""
    try:
        facts = read_json(out / STUDY)
    except (OSError, ValueError):
        return {}
    return facts if isinstance(facts, dict) else {}
