"""The tidy table of scores: its columns, functions that make rows, and `select`.

A row is one number, with the columns metric, dimension, step, scenario and value. The dimension
"all", the step -1 and the scenario -1 mean an average over this axis. Steps count from 1 to T,
scenarios from 0. The table of a whole study also has the columns `CELL`.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from study.common.arrays import Array
from study.config.grid import Cell

CELL = ("environment", "level", "model", "seed")
COLUMNS = ("metric", "dimension", "step", "scenario", "value")

LEVELLESS = frozenset({"oracle"})
"""Models without training data, which are the same at every level."""


def cell_name(row: Mapping[Any, Any]) -> str:
    """The name of the cell of a row with the columns `CELL`."""
    return Cell(*(row[column] for column in CELL)).name


def select(
    scores: pd.DataFrame,
    metric: str,
    environment: str,
    level: str,
    model: str,
    by: str = "scenario",
) -> pd.DataFrame:
    """One metric of one environment, level and model, as a table of seeds × `by`.

    The table of scores contains the averages over the other axes. A model of `LEVELLESS` may have
    scores at one level only; they are then used for all levels.

    Args:
        scores: the tidy table, with the columns of `CELL`.
        metric: its name.
        environment: of the cell.
        level: of the cell.
        model: of the cell.
        by: "scenario", "dimension" or "step", or two of them: "step and scenario" and "dimension
            and step" give columns with two levels.

    Returns:
        One row a seed; empty if the table has no such scores.
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
    for axis, average in (("dimension", "all"), ("step", -1), ("scenario", -1)):
        averaged = chosen[axis] == average
        chosen = chosen[~averaged if axis in axes else averaged]
    return chosen.pivot(index="seed", columns=axes if axes[1:] else axes[0], values="value")


def rows(
    metric: str,
    values: Array,
    dimension: Array | str = "all",
    step: Array | int = -1,
    scenario: Array | int = -1,
) -> pd.DataFrame:
    """Rows of one metric from values of any shape; arrays of labels have the same order."""
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
    """Rows from values [T, D]; the D names of dimensions are an array of objects."""
    step, dimension = np.mgrid[: values.shape[0], : values.shape[1]]
    return rows(metric, values, dimensions[dimension], step + 1)


def by_step_and_scenario(metric: str, values: Array) -> pd.DataFrame:
    """Rows from values [S, T]."""
    scenario, step = np.mgrid[: values.shape[0], : values.shape[1]]
    return rows(metric, values, "all", step + 1, scenario)


def by_dimension(metric: str, values: Array, dimensions: Array) -> pd.DataFrame:
    """Rows from values [D]; the D names of dimensions are an array of objects."""
    return rows(metric, values, dimensions[: len(values)])


def by_step(metric: str, values: Array) -> pd.DataFrame:
    """Rows from values [T]."""
    return rows(metric, values, "all", np.arange(1, len(values) + 1))


def by_scenario(metric: str, values: Array, dimension: str = "all") -> pd.DataFrame:
    """Rows from values [S]."""
    return rows(metric, values, dimension, -1, np.arange(len(values)))


def overall(metric: str, value: float, dimension: str = "all") -> pd.DataFrame:
    """One row: an average over steps and scenarios, and over dimensions unless one is named."""
    return rows(metric, np.array([value]), dimension)
