"""Minari data sets in HDF5: one table with the rows of all episodes.

Columns are ``observation[0]``, … and ``action[0]``, …. A data set that `export` wrote names its
variables: columns are then ``NAME``, ``goal.NAME`` and ``action.NAME``, in the units of the system.
The last row of an episode has no action. Messages count rows from 0.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from study.common.arrays import Array, Doubles
from study.common.errors import BadInput
from study.data.readers.table import Table

FILE = "main_data.hdf5"


def read(path: Path) -> list[Table]:
    """One table with all episodes.

    Raises:
        BadInput: observations or actions are no arrays of numbers.
    """
    import h5py

    file_path = path / "data" / FILE if path.is_dir() else path
    facts = _facts(file_path.parent)
    parts: list[Doubles] = []
    episodes: list[Array] = []
    widths = (0, 0)
    with h5py.File(file_path, "r") as file:
        names = sorted((n for n in file if n.startswith("episode_")), key=_number)
        for name in names:
            observations, actions = (
                _array(path, file[name], k) for k in ("observations", "actions")
            )
            widths = observations.shape[1], actions.shape[1]
            padded = np.full((len(observations), widths[1]), np.nan)
            padded[: len(actions)] = actions
            parts.append(np.concatenate([observations, padded], axis=1))
            episodes.append(np.full(len(observations), _number(name)))
    if not parts:
        raise BadInput(f"{path}: it has no episodes")
    values = np.concatenate(parts)
    columns = _names(facts, *widths)
    if facts:
        values[:, widths[0] :] = _unscaled(values[:, widths[0] :], facts["action"])
    table = {column: values[:, i] for i, column in enumerate(columns)}
    episode = np.concatenate(episodes)
    time = None
    if step := facts.get("control_step"):
        time = float(step) * np.concatenate([np.arange(len(part)) for part in parts])
    return [Table(table, time, episode, first_row=0)]


def _array(path: Path, episode: Any, key: str) -> Doubles:
    entry = episode[key]
    if not hasattr(entry, "shape"):
        raise BadInput(f"{path}: its {key} are a dictionary; give a data set with arrays")
    values = np.asarray(entry, np.float64)
    return values.reshape(len(values), -1)


def _number(name: str) -> int:
    return int(name.removeprefix("episode_"))


def _facts(folder: Path) -> Mapping[str, Any]:
    """The facts that `export` wrote; empty for other data sets."""
    try:
        metadata = json.loads((folder / "metadata.json").read_text(encoding="utf-8"))
        facts = metadata["study"]
        return dict(facts) if {"state", "action", "goal"} <= set(facts) else {}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _names(facts: Mapping[str, Any], observations: int, actions: int) -> list[str]:
    if not facts:
        return [
            *(f"observation[{i}]" for i in range(observations)),
            *(f"action[{i}]" for i in range(actions)),
        ]
    return [
        *(v["name"] for v in facts["state"]),
        *(f"goal.{v['name']}" for v in facts["goal"]),
        *(f"action.{v['name']}" for v in facts["action"]),
    ]


def _unscaled(actions: Doubles, variables: Sequence[Mapping[str, Any]]) -> Doubles:
    """Actions between -1 and 1 in the units of the system."""
    low, high = (np.array([v[bound] for v in variables]) for bound in ("low", "high"))
    return np.asarray(low + (actions + 1) / 2 * (high - low))
