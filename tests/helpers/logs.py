"""Small logs, and the settings that describe them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from study.config.recorded import Recorded
from study.data.recorded.description import Description
from study.data.recorded.pieces import Piece, pieces_of

STEP = 0.1
SETTINGS = Recorded(state=("x [m]", "v"), action=("u",), time="t", horizon=10, stride=5)


def log(rows: int = 40, seed: int = 0) -> pd.DataFrame:
    """A cart with random accelerations."""
    u = np.random.default_rng(seed).normal(size=rows)
    v = np.cumsum(u) * STEP
    return pd.DataFrame({"t": STEP * np.arange(rows), "x": np.cumsum(v) * STEP, "v": v, "u": u})


def write(folder: Path, count: int = 6, rows: int = 40) -> tuple[str, ...]:
    """Write `count` logs, and give their paths."""
    paths = [folder / f"{number}.csv" for number in range(count)]
    for seed, path in enumerate(paths):
        log(rows, seed).to_csv(path, index=False)
    return tuple(map(str, paths))


def pieces(path: Path, **changes: object) -> list[Piece]:
    """The pieces of a log."""
    settings = replace(SETTINGS, files=(str(path),), **changes)  # type: ignore[arg-type]
    return list(pieces_of(path, Description("cart", settings)))
