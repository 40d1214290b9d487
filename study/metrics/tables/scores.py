"""All scores of one set of forecasts in one tidy table (see `study.metrics.tables.table`).

==========================  =======================================================================
metric                      rows
==========================  =======================================================================
mmd2                        by dimension and step; by step and scenario; by step; by scenario; all
mmd                         by step; all: biased MMD, averaged after the square root
mmd2_half, mmd2_double      by step; by scenario; all: half and twice the bandwidth
mmd2_joint                  by step; by scenario; all: one kernel for the whole state
mmd2_pooled                 by dimension and step; by step; all: samples of all scenarios pooled, at
                            ten steps of the horizon
mmd2_shift_0.1, _0.3, _1    by step; all: reference shifts, of the oracle only: the MMD² of its
                            forecasts, shifted by 0.1, 0.3 and 1 standard deviations of the
                            observed rollouts
variance_ratio              by dimension and step; by step: the mean over dimensions with a true
                            variance that is not negligible, NaN without any
nonfinite                   all: the share of forecast values that are not finite
==========================  =======================================================================

and the rows of `study.metrics.tables.outcome_scores` and `study.metrics.tables.trajectory_scores`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from study.common.arrays import Array
from study.metrics.joint_mmd import joint_mmd
from study.metrics.mmd import OnProgress, mmd, pooled, sensitivity, shifted
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
"""Steps of the horizon at which pooled MMD² is computed: all steps would dominate the run time."""

SHIFTS = (0.1, 0.3, 1.0)
"""Reference shifts, in standard deviations of the observed rollouts."""

SHIFT_METRICS = {f"mmd2_shift_{shift:g}": shift for shift in SHIFTS}
"""The metric of each reference shift."""


@dataclass(frozen=True)
class Outcomes:
    """Outcomes of forecasts and of observed rollouts.

    Attributes:
        forecast: by name, the goal first: [S, K] bool.
        observed: by the same names: [S, L] bool.
        forecast_by_step: [S, K, T] bool, whether the goal is reached by each step.
        observed_by_step: [S, L, T] bool, the same for rollouts.
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
    reference_shifts: bool = False,
    progress: OnProgress | None = None,
) -> pd.DataFrame:
    """Score forecasts against observed rollouts of the same scenarios.

    Args:
        forecast: [S, K, T, D] float32, physical units, K ≥ 2.
        observed: [S, L, T, D] float32, physical units, finite. With L = 1, the rows that compare
            variances are left out.
        outcomes: of both. Without any, their rows are left out.
        scale: [D], standard deviations of the training data.
        bandwidth: [D], from `study.metrics.mmd.bandwidths`.
        names: D names of dimensions.
        member: [S, K] integers, the ensemble member of each sample; None without an ensemble.
        reference_shifts: whether to score the forecasts shifted by `SHIFTS` as well.
        progress: called with the fraction that is done.

    Returns:
        The rows of the module's table.

    Raises:
        ValueError: shapes that do not match, too few samples, or a non-finite observed value.
    """
    _check(forecast, observed, outcomes, names)
    finite = np.isfinite(forecast)
    report = progress or (lambda _: None)
    parts = _discrepancies(forecast, observed, scale, bandwidth, names, reference_shifts, report)
    report(0.8)
    if observed.shape[1] > 1:
        ratio = variance_ratio(forecast, observed, scale)
        parts += [
            by_dimension_and_step("variance_ratio", ratio, np.array(names, object)),
            by_step("variance_ratio", mean_of_known(ratio, 1)),
        ]
    if outcomes.forecast:
        parts.append(
            outcome_rows(
                outcomes.forecast,
                outcomes.observed,
                outcomes.forecast_by_step,
                outcomes.observed_by_step,
                np.asarray(finite.all((2, 3))),
            )
        )
    parts += [
        trajectory_rows(forecast, observed, scale, names, member),
        overall("nonfinite", 1 - finite.mean()),
    ]
    report(1.0)
    return pd.concat(parts, ignore_index=True)


def _discrepancies(
    forecast: Array,
    observed: Array,
    scale: Array,
    bandwidth: Array,
    names: Sequence[str],
    reference_shifts: bool,
    report: OnProgress,
) -> list[pd.DataFrame]:
    kernel = (scale, bandwidth)
    half, usual, double = sensitivity(
        forecast, observed, *kernel, progress=lambda fraction: report(0.4 * fraction)
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
    joint = joint_mmd(
        forecast, observed, *kernel, progress=lambda fraction: report(0.4 + 0.3 * fraction)
    )
    steps = np.unique(np.linspace(0, forecast.shape[2] - 1, POOLED_STEPS).round().astype(int))
    over_scenarios = pooled(forecast[:, :, steps], observed[:, :, steps], *kernel).squared
    step, dimension = np.meshgrid(steps + 1, dimensions, indexing="ij")
    parts += [
        *_averages("mmd2_joint", joint.squared),
        rows("mmd2_pooled", over_scenarios, dimension, step),
        rows("mmd2_pooled", over_scenarios.mean(1), "all", steps + 1),
        overall("mmd2_pooled", over_scenarios.mean()),
    ]
    for metric, shift in SHIFT_METRICS.items() if reference_shifts else ():
        squared = mmd(shifted(forecast, observed, shift), observed, *kernel).squared
        parts += [by_step(metric, squared.mean((0, 2))), overall(metric, squared.mean())]
    return parts


def _averages(metric: str, values: Array) -> list[pd.DataFrame]:
    """Rows from values [S, T], averaged over one axis and over both."""
    return [
        by_step(metric, values.mean(0)),
        by_scenario(metric, values.mean(1)),
        overall(metric, values.mean()),
    ]


def _check(forecast: Array, observed: Array, outcomes: Outcomes, names: Sequence[str]) -> None:
    scenarios, samples, steps, dimensions = forecast.shape
    rollouts = observed.shape[1]
    shapes = {
        "observed rollouts": (observed.shape, (scenarios, rollouts, steps, dimensions)),
        "forecast outcomes": (outcomes.forecast_by_step.shape, (scenarios, samples, steps)),
        "observed outcomes": (outcomes.observed_by_step.shape, (scenarios, rollouts, steps)),
        "names": ((len(names),), (dimensions,)),
    }
    for what, (shape, expected) in shapes.items():
        if shape != expected:
            raise ValueError(
                f"{what} of shape {shape} do not match forecasts of shape {forecast.shape}"
            )
