"""The tidy table of scores: its columns, how to write rows of it, and how to read a metric back.

A row is one number: metric, dimension, step, scenario, value. "all" in place of a dimension and -1
in place of a step or a scenario mean "averaged over this axis". Steps count from 1 to T, scenarios
from 0. In front stand the columns that name the cell, once all cells are in one table.
"""

import numpy as np
import pandas as pd

from study.common.arrays import Array

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


def rows(
    metric: str,
    values: Array,
    dimension: Array | str = "all",
    step: Array | int = -1,
    scenario: Array | int = -1,
) -> pd.DataFrame:
    """Rows of one metric from values of any shape; the axes are given in the same order."""
    values = np.asarray(values, np.float64)
    count = values.size
    return pd.DataFrame(
        {
            "metric": metric,
            "dimension": np.ravel(dimension) if isinstance(dimension, np.ndarray) else dimension,
            "step": np.broadcast_to(np.ravel(step), count).astype(np.int32),
            "scenario": np.broadcast_to(np.ravel(scenario), count).astype(np.int32),
            "value": values.ravel(),
        },
        columns=list(COLUMNS),
    )


def by_dimension_and_step(metric: str, values: Array, dimensions: Array) -> pd.DataFrame:
    """Values [T, D]; the D names of dimensions are an array of objects."""
    step, dimension = np.mgrid[: values.shape[0], : values.shape[1]]
    return rows(metric, values, dimensions[dimension], step + 1)


def by_step_and_scenario(metric: str, values: Array) -> pd.DataFrame:
    """Values [S, T]."""
    scenario, step = np.mgrid[: values.shape[0], : values.shape[1]]
    return rows(metric, values, "all", step + 1, scenario)


def by_dimension(metric: str, values: Array, dimensions: Array) -> pd.DataFrame:
    """Values [D]; the D names of dimensions are an array of objects."""
    return rows(metric, values, dimensions[: len(values)])


def by_step(metric: str, values: Array) -> pd.DataFrame:
    """Values [T]."""
    return rows(metric, values, "all", np.arange(1, len(values) + 1))


def by_scenario(metric: str, values: Array, dimension: str = "all") -> pd.DataFrame:
    """Values [S]."""
    return rows(metric, values, dimension, -1, np.arange(len(values)))


def overall(metric: str, value: float, dimension: str = "all") -> pd.DataFrame:
    """One value, averaged over everything but perhaps a dimension."""
    return rows(metric, np.array([value]), dimension)
