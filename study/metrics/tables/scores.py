"""All scores of one set of forecasts in one tidy table (see `study.metrics.tables.table`).

==========================  =======================================================================
metric                      rows
==========================  =======================================================================
mmd2                        by dimension and step; by step and scenario; by step; by scenario; all
mmd                         by step; all (the biased root, averaged after the root)
mmd2_half, mmd2_double      by step; by scenario; all: half and twice the bandwidth
mmd2_joint                  by step; by scenario; all: one kernel for the whole state
mmd2_pooled                 by dimension and step; by step; all: scenarios thrown together, at ten
                            steps of the horizon
mmd2_shift_0.1, _0.3, _1    by step; all: the ruler, of a reference only: its MMD² if shifted
                            by so many standard deviations of the scenario's observed rollouts
variance_ratio              by dimension and step; by step: the mean over the dimensions whose true
                            variance is not negligible, NaN if there are none
nonfinite                   all: the share of forecast values that are not finite
==========================  =======================================================================

and the rows of `study.metrics.tables.outcome_scores` and `study.metrics.tables.trajectory_scores`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from study.common.arrays import Array
from study.metrics.joint_mmd import joint_mmd
from study.metrics.mmd import mmd, pooled, sensitivity, shifted
from study.metrics.tables.outcome_scores import outcome_rows
from study.metrics.tables.table import (
    by_dimension_and_step,
    by_scenario,
    by_step,
    by_step_and_scenario,
    overall,
    rows,
)
from study.metrics.tables.trajectory_scores import trajectory_rows
from study.metrics.variance import mean_of_known, variance_ratio

POOLED_STEPS = 10
SHIFTS = (0.1, 0.3, 1.0)
"""Of the ruler, in standard deviations of the observed rollouts."""


@dataclass(frozen=True)
class Outcomes:
    """What happens in forecasts and in observed rollouts.

    Attributes:
        forecast: by name, the goal itself first: [S, K] bool.
        observed: the same names: [S, L] bool.
        forecast_by_step: [S, K, T] bool, whether the goal has succeeded by each step.
        observed_by_step: [S, L, T] bool.
    """

    forecast: Mapping[str, Array]
    observed: Mapping[str, Array]
    forecast_by_step: Array
    observed_by_step: Array


def score(
    forecast: Array,
    observed: Array,
    outcomes: Outcomes,
    scale: Array,
    bandwidth: Array,
    names: Sequence[str],
    member: Array | None = None,
    ruler: bool = False,
    progress: Callable[[float], None] | None = None,
) -> pd.DataFrame:
    """Score forecasts against observed rollouts of the same scenarios.

    Args:
        forecast: [S, K, T, D] float32, physical units, K ≥ 2.
        observed: [S, L, T, D] float32, physical units, L ≥ 2, finite.
        outcomes: of both.
        scale: [D], standard deviations of the training data.
        bandwidth: [D], from `study.metrics.mmd.bandwidths`.
        names: D names of dimensions.
        member: [S, K] integers, the ensemble member of each sample; None without an ensemble.
        ruler: whether to score the forecasts shifted as well.
        progress: told the share that is done, 0 to 1.

    Raises:
        ValueError: shapes that do not fit, too few samples, or a non-finite observed value.
    """
    _check(forecast, observed, outcomes, names)
    finite = np.isfinite(forecast)
    tell = progress or (lambda _: None)
    parts = _discrepancies(forecast, observed, scale, bandwidth, names, ruler, tell)
    tell(0.8)
    ratio = variance_ratio(forecast, observed, scale)
    parts += [
        by_dimension_and_step("variance_ratio", ratio, np.array(names, object)),
        by_step("variance_ratio", mean_of_known(ratio, 1)),
        outcome_rows(
            outcomes.forecast,
            outcomes.observed,
            outcomes.forecast_by_step,
            outcomes.observed_by_step,
            np.asarray(finite.all((2, 3))),
        ),
        trajectory_rows(forecast, observed, scale, names, member),
        overall("nonfinite", 1 - finite.mean()),
    ]
    tell(1.0)
    return pd.concat(parts, ignore_index=True)


def _discrepancies(
    forecast: Array,
    observed: Array,
    scale: Array,
    bandwidth: Array,
    names: Sequence[str],
    ruler: bool,
    tell: Callable[[float], None],
) -> list[pd.DataFrame]:
    kernel = (scale, bandwidth)
    half, usual, double = sensitivity(
        forecast, observed, *kernel, progress=lambda share: tell(0.4 * share)
    )
    dimensions = np.array(names, object)
    parts = [
        by_dimension_and_step("mmd2", usual.squared.mean(0), dimensions),
        by_step_and_scenario("mmd2", usual.squared.mean(2)),
        *_averages("mmd2", usual.squared.mean(2)),
        by_step("mmd", usual.biased.mean((0, 2))),
        overall("mmd", usual.biased.mean()),
        *_averages("mmd2_half", half.squared.mean(2)),
        *_averages("mmd2_double", double.squared.mean(2)),
    ]
    joint = joint_mmd(forecast, observed, *kernel, progress=lambda share: tell(0.4 + 0.3 * share))
    # Ten steps show it as well as all of them, which would take longer than all the rest.
    steps = np.unique(np.linspace(0, forecast.shape[2] - 1, POOLED_STEPS).round().astype(int))
    together = pooled(forecast[:, :, steps], observed[:, :, steps], *kernel).squared
    step, dimension = np.meshgrid(steps + 1, dimensions, indexing="ij")
    parts += [
        *_averages("mmd2_joint", joint.squared),
        rows("mmd2_pooled", together, dimension, step),
        rows("mmd2_pooled", together.mean(1), "all", steps + 1),
        overall("mmd2_pooled", together.mean()),
    ]
    for shift in SHIFTS if ruler else ():
        moved = mmd(shifted(forecast, observed, shift), observed, *kernel).squared
        parts += [
            by_step(f"mmd2_shift_{shift:g}", moved.mean((0, 2))),
            overall(f"mmd2_shift_{shift:g}", moved.mean()),
        ]
    return parts


def _averages(metric: str, values: Array) -> list[pd.DataFrame]:
    """Values [S, T], averaged over one axis and over both."""
    return [
        by_step(metric, values.mean(0)),
        by_scenario(metric, values.mean(1)),
        overall(metric, values.mean()),
    ]


def _check(forecast: Array, observed: Array, outcomes: Outcomes, names: Sequence[str]) -> None:
    scenarios, samples, steps, dimensions = forecast.shape
    rollouts = observed.shape[1]
    wanted = {
        "observed rollouts": (observed.shape, (scenarios, rollouts, steps, dimensions)),
        "forecast outcomes": (outcomes.forecast_by_step.shape, (scenarios, samples, steps)),
        "observed outcomes": (outcomes.observed_by_step.shape, (scenarios, rollouts, steps)),
        "names": ((len(names),), (dimensions,)),
    }
    for what, (given, fits) in wanted.items():
        if given != fits:
            raise ValueError(f"{what} of shape {given} do not fit forecasts {forecast.shape}")
