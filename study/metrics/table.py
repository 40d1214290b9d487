"""The tidy table of scores: its columns, and how to read one metric of one cell back.

A row is one number: metric, dimension, step, scenario, value. "all" in place of a dimension and -1
in place of a step or a scenario mean "averaged over this axis". Steps count from 1 to T, scenarios
from 0. In front stand the columns that name the cell, once all cells are in one table.
"""

import pandas as pd

CELL = ("environment", "level", "model", "seed")
COLUMNS = ("metric", "dimension", "step", "scenario", "value")

LEVELLESS = frozenset({"oracle"})
"""Models that do not depend on how much data there is to train on."""


def select(
    scores: pd.DataFrame,
    metric: str,
    environment: str,
    level: str,
    model: str,
    by: str = "scenario",
) -> pd.DataFrame:
    """One metric of one environment, level and model: seeds × `by`, a column of the table.

    Averages over the other axes are the ones that are stored. `by` "scenario", "dimension" or
    "step"; "step and scenario" gives two-level columns (step, scenario), and "dimension and step"
    (dimension, step). Empty if the table holds no such rows.

    A reference whose level the table does not know (the oracle learns from no data, so it may be
    scored once for all levels) is taken at the level that it has.
    """
    axes = by.split(" and ")
    chosen = scores[
        (scores["metric"] == metric)
        & (scores["environment"] == environment)
        & (scores["model"] == model)
    ]
    if model in LEVELLESS and not (chosen["level"] == level).any() and len(chosen):
        level = str(chosen["level"].iloc[0])
    chosen = chosen[chosen["level"] == level]
    for axis, everything in (("dimension", "all"), ("step", -1), ("scenario", -1)):
        averaged = chosen[axis] == everything
        chosen = chosen[~averaged if axis in axes else averaged]
    return chosen.pivot(index="seed", columns=axes if axes[1:] else axes[0], values="value")
