"""LeRobot data sets (version 3, and version 2 with one file an episode): plain Parquet files.

Columns are ``observation.state.NAME`` and ``action.NAME``, with the names of ``meta/info.json``, or
``[0]``, ``[1]``, … without names. Images are left out. Messages count rows of the data set from 0.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from study.common.arrays import Array
from study.common.errors import BadInput
from study.data.readers.table import Table

EPISODE, TIME = "episode_index", "timestamp"
LEFT_OUT = ("index", "frame_index", "task_index", EPISODE, TIME)


def read(path: Path) -> list[Table]:
    """One table with all episodes.

    Raises:
        BadInput: the folder has no data, or the data have no episodes.
    """
    info = json.loads((path / "meta" / "info.json").read_text(encoding="utf-8"))
    files = sorted((path / "data").rglob("*.parquet"))
    if not files:
        raise BadInput(f"{path}: it has no Parquet file in 'data'")
    frame = pd.concat([pq.read_table(file).to_pandas() for file in files], ignore_index=True)
    if EPISODE not in frame:
        raise BadInput(f"{path}: its data have no column '{EPISODE}'")
    columns: dict[str, Array] = {}
    for name in frame:
        if name not in LEFT_OUT:
            columns |= _columns(str(name), frame[name], info.get("features", {}).get(name, {}))
    time = frame[TIME].to_numpy(np.float64) if TIME in frame else None
    return [Table(columns, time, frame[EPISODE].to_numpy(), first_row=0)]


def _columns(name: str, values: "pd.Series[Any]", feature: dict[str, Any]) -> dict[str, Array]:
    """The columns of a feature: one, or one for each component."""
    if pd.api.types.is_numeric_dtype(values):
        return {name: values.to_numpy()}
    first = values.iloc[0]
    if not isinstance(first, list | np.ndarray) or np.ndim(first) != 1:
        return {}
    table = np.stack([np.asarray(row, np.float64) for row in values])
    names = feature.get("names")
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    if not isinstance(names, list) or len(names) != table.shape[1]:
        return {f"{name}[{i}]": column for i, column in enumerate(table.T)}
    return {f"{name}.{part}": column for part, column in zip(names, table.T, strict=True)}
