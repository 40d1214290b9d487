"""Rows of the tidy table: proper scores, calibration and variances (see `tables.table`).

==========================  =======================================================================
metric                      rows
==========================  =======================================================================
crps                        by dimension; by step; by scenario; all (in standard deviations of the
                            training data)
energy_score                by step; by scenario; all
coverage_50, _80, _90       by dimension; by step; all
pit_01 … pit_20             by dimension; all: the share of rollouts in each bin of the PIT
variance_ratio              all
aleatoric_ratio             by dimension and step; by dimension; by step; all
epistemic_share             by dimension and step; by step; all
log_score                   by step; by scenario; all (`log_score_rows`, of recorded systems alone)
==========================  =======================================================================

Averages of variances are over variances that are not negligible; NaN without any.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from study.common.arrays import Array
from study.metrics.calibration import coverage, pit, rank_histogram
from study.metrics.proper_scores import crps, energy_score
from study.metrics.tables.table import (
    by_dimension,
    by_dimension_and_step,
    by_scenario,
    by_step,
    overall,
)
from study.metrics.variance import (
    Decomposition,
    aleatoric_ratio,
    decompose,
    epistemic_share,
    mean_of_known,
    variance_ratio,
)

INTERVALS = (50, 80, 90)
"""Probabilities of the central intervals, in per cent."""


def trajectory_rows(
    forecast: Array,
    observed: Array,
    scale: Array,
    names: Sequence[str],
    member: Array | None = None,
) -> pd.DataFrame:
    """All rows of this module for one set of forecasts.

    Args:
        forecast: [S, K, T, D], physical units, K ≥ 2. Each metric has its own rule for non-finite
            values; all score the worst case.
        observed: [S, L, T, D], physical units, finite. Ratios of variances need L ≥ 2 and are left
            out with L = 1.
        scale: [D], standard deviations of the training data.
        names: D names of dimensions.
        member: [S, K] integers, the ensemble member of each sample; None without an ensemble.

    Raises:
        ValueError: fewer than two samples, or a non-finite observed value.
    """
    dimensions = np.array([*names, "all"], object)
    parts = [
        *_proper(forecast, observed, scale, dimensions),
        *_calibration(forecast, observed, dimensions),
        *_variances(forecast, observed, scale, dimensions, member),
    ]
    return pd.concat(parts, ignore_index=True)


def log_score_rows(values: Array) -> pd.DataFrame:
    """The rows of the log score.

    Args:
        values: [S, T], nats for each dimension.
    """
    parts = [
        by_step("log_score", values.mean(0)),
        by_scenario("log_score", values.mean(1)),
        overall("log_score", values.mean()),
    ]
    return pd.concat(parts, ignore_index=True)


def _proper(
    forecast: Array, observed: Array, scale: Array, dimensions: Array
) -> list[pd.DataFrame]:
    marginal, joint = crps(forecast, observed, scale), energy_score(forecast, observed, scale)
    return [
        by_dimension("crps", marginal.mean((0, 1)), dimensions),
        by_step("crps", marginal.mean((0, 2))),
        by_scenario("crps", marginal.mean((1, 2))),
        overall("crps", marginal.mean()),
        by_step("energy_score", joint.mean(0)),
        by_scenario("energy_score", joint.mean(1)),
        overall("energy_score", joint.mean()),
    ]


def _calibration(forecast: Array, observed: Array, dimensions: Array) -> list[pd.DataFrame]:
    ranks = rank_histogram(forecast, observed)
    rows = []
    for percent in INTERVALS:
        metric, covered = f"coverage_{percent}", coverage(ranks, percent / 100)
        rows += [
            by_dimension(metric, covered.mean(0), dimensions),
            by_step(metric, covered.mean(1)),
            overall(metric, covered.mean()),
        ]
    shares = pit(ranks.mean(0))
    for bin_number, share in enumerate(shares.T, start=1):
        metric = f"pit_{bin_number:02}"
        rows += [by_dimension(metric, share, dimensions), overall(metric, share.mean())]
    return rows


def _ratios(
    predicted: Decomposition, forecast: Array, observed: Array, scale: Array, dimensions: Array
) -> list[pd.DataFrame]:
    """The rows that compare with the variance of repeated rollouts."""
    ratio = aleatoric_ratio(predicted, observed, scale)
    return [
        overall("variance_ratio", float(mean_of_known(variance_ratio(forecast, observed, scale)))),
        by_dimension_and_step("aleatoric_ratio", ratio, dimensions),
        by_dimension("aleatoric_ratio", mean_of_known(ratio, 0), dimensions),
        by_step("aleatoric_ratio", mean_of_known(ratio, 1)),
        overall("aleatoric_ratio", float(mean_of_known(ratio))),
    ]


def _variances(
    forecast: Array, observed: Array, scale: Array, dimensions: Array, member: Array | None
) -> list[pd.DataFrame]:
    predicted = decompose(forecast, member)
    share = epistemic_share(predicted, scale)
    return [
        *(
            _ratios(predicted, forecast, observed, scale, dimensions)
            if observed.shape[1] > 1
            else ()
        ),
        by_dimension_and_step("epistemic_share", share, dimensions),
        by_step("epistemic_share", mean_of_known(share, 1)),
        overall("epistemic_share", float(mean_of_known(share))),
    ]
