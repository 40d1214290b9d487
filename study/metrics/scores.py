"""All scores of one set of forecasts in one tidy table (see `study.metrics.table`).

==========================  =======================================================================
metric                      rows
==========================  =======================================================================
mmd2                        by dimension and step; by step and scenario; by step; by scenario; all
mmd                         by step; all (the biased root, averaged after the root)
brier                       by scenario; all
brier_two_class             all
brier_climatology           by scenario; all
forecast_probability        by scenario: the share of samples that are finite and succeed
observed_probability        by scenario: the share of rollouts that succeed
variance_ratio              by dimension and step; by step: the mean over the dimensions whose true
                            variance is not negligible, NaN if there are none
nonfinite                   all: the share of forecast values that are not finite
==========================  =======================================================================
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from study.metrics.brier import brier, climatology, two_class
from study.metrics.mmd import mmd
from study.metrics.table import COLUMNS
from study.metrics.variance import variance_ratio

Array = NDArray[Any]
Doubles = NDArray[np.float64]


def score(
    forecast: Array,
    observed: Array,
    forecast_outcome: Array,
    observed_outcome: Array,
    scale: Array,
    bandwidth: Array,
    names: Sequence[str],
    among_observed: Doubles | None = None,
    progress: Callable[[float], None] | None = None,
) -> pd.DataFrame:
    """Score forecasts against observed rollouts of the same scenarios.

    Args:
        forecast: [S, K, T, D] float32, physical units, K ≥ 2.
        observed: [S, L, T, D] float32, physical units, L ≥ 2, finite.
        forecast_outcome: [S, K] bool, whether the task succeeds in each sample.
        observed_outcome: [S, L] bool.
        scale: [D], standard deviations of the training data.
        bandwidth: [D], from `study.metrics.mmd.bandwidths`.
        names: D names of dimensions.
        among_observed: [S, T, D] from `study.metrics.mmd.similarity`; computed here if not given.
        progress: told the share that is done, 0 to 1.

    Raises:
        ValueError: shapes that do not fit, too few samples, or a non-finite observed value.
    """
    _check(forecast, observed, forecast_outcome, observed_outcome, names)
    finite = np.isfinite(forecast)
    discrepancy = mmd(forecast, observed, scale, bandwidth, among_observed, progress)
    squared, biased = discrepancy.squared, discrepancy.biased
    valid = np.asarray(finite.all((2, 3)))
    brier_score = brier(forecast_outcome, observed_outcome, valid)
    base_rate = climatology(observed_outcome)
    ratio = variance_ratio(forecast, observed, scale)
    successes = forecast_outcome & valid
    dimensions = np.array([*names, "all"], object)
    return pd.concat(
        [
            _by_dimension_and_step("mmd2", squared.mean(0), dimensions),
            _by_step_and_scenario("mmd2", squared.mean(2)),
            _by_step("mmd2", squared.mean((0, 2))),
            _by_scenario("mmd2", squared.mean((1, 2))),
            _overall("mmd2", squared.mean()),
            _by_step("mmd", biased.mean((0, 2))),
            _overall("mmd", biased.mean()),
            _by_scenario("brier", brier_score),
            _overall("brier", brier_score.mean()),
            _overall("brier_two_class", two_class(brier_score).mean()),
            _by_scenario("brier_climatology", base_rate),
            _overall("brier_climatology", base_rate.mean()),
            _by_scenario("forecast_probability", successes.mean(1)),
            _by_scenario("observed_probability", observed_outcome.mean(1)),
            _by_dimension_and_step("variance_ratio", ratio, dimensions),
            _by_step("variance_ratio", _mean_of_known(ratio)),
            _overall("nonfinite", 1 - finite.mean()),
        ],
        ignore_index=True,
    )


def _check(
    forecast: Array,
    observed: Array,
    forecast_outcome: Array,
    observed_outcome: Array,
    names: Sequence[str],
) -> None:
    scenarios, samples, steps, dimensions = forecast.shape
    rollouts = observed.shape[1]
    wanted = {
        "observed rollouts": (observed.shape, (scenarios, rollouts, steps, dimensions)),
        "forecast outcomes": (forecast_outcome.shape, (scenarios, samples)),
        "observed outcomes": (observed_outcome.shape, (scenarios, rollouts)),
        "names": ((len(names),), (dimensions,)),
    }
    for what, (given, fits) in wanted.items():
        if given != fits:
            raise ValueError(f"{what} of shape {given} do not fit forecasts {forecast.shape}")


def _mean_of_known(ratio: Array) -> Doubles:
    known = ~np.isnan(ratio)
    total = np.where(known, ratio, 0).sum(1)
    return np.divide(total, known.sum(1), out=np.full(len(ratio), np.nan), where=known.any(1))


def _by_dimension_and_step(metric: str, values: Array, dimensions: Array) -> pd.DataFrame:
    """Values [T, D]."""
    step, dimension = np.mgrid[: values.shape[0], : values.shape[1]]
    return _rows(metric, values, dimensions[dimension], step + 1)


def _by_step_and_scenario(metric: str, values: Array) -> pd.DataFrame:
    """Values [S, T]."""
    scenario, step = np.mgrid[: values.shape[0], : values.shape[1]]
    return _rows(metric, values, "all", step + 1, scenario)


def _by_step(metric: str, values: Array) -> pd.DataFrame:
    return _rows(metric, values, "all", np.arange(1, len(values) + 1))


def _by_scenario(metric: str, values: Array) -> pd.DataFrame:
    return _rows(metric, values, "all", -1, np.arange(len(values)))


def _overall(metric: str, value: float) -> pd.DataFrame:
    return _rows(metric, np.array([value]))


def _rows(
    metric: str,
    values: Array,
    dimension: Array | str = "all",
    step: Array | int = -1,
    scenario: Array | int = -1,
) -> pd.DataFrame:
    count = values.size
    return pd.DataFrame(
        {
            "metric": metric,
            "dimension": np.ravel(dimension) if isinstance(dimension, np.ndarray) else dimension,
            "step": np.broadcast_to(np.ravel(step), count).astype(np.int32),
            "scenario": np.broadcast_to(np.ravel(scenario), count).astype(np.int32),
            "value": values.ravel().astype(np.float64),
        },
        columns=list(COLUMNS),
    )
