"""Rows of the tidy table: scores of forecast outcomes (see `study.metrics.tables.table`).

The column `dimension` has the name of an outcome; "all" is the goal.

==========================  =======================================================================
metric                      rows, of every outcome unless "goal" is stated
==========================  =======================================================================
brier                       by scenario; all; goal by step: reached by step t
brier_fair                  goal by scenario; all
brier_reliability           all: terms of the mean fair score
brier_resolution            brier_reliability - brier_resolution + brier_uncertainty
brier_uncertainty
brier_climatology           goal by scenario; all
brier_two_class             goal, all
forecast_probability        by scenario: the share of samples that are finite and succeed; goal by
                            step: the mean over scenarios
observed_probability        by scenario: the share of rollouts that succeed; goal by step
==========================  =======================================================================

A sample with a non-finite value counts as wrong at every step. If there is one, brier_reliability
is ∞ and brier_resolution -∞. An outcome that always happens, or never, has an uncertainty and a
climatology of 0, and its skill is NaN. With one scenario the terms of the decomposition are NaN.
"""

from collections.abc import Mapping

import numpy as np
import pandas as pd

from study.common.arrays import Array
from study.metrics.brier import brier, brier_fair, climatology, two_class
from study.metrics.reliability import decompose
from study.metrics.tables.table import by_scenario, by_step, overall


def outcome_rows(
    forecast_outcomes: Mapping[str, Array],
    observed_outcomes: Mapping[str, Array],
    forecast_by_step: Array,
    observed_by_step: Array,
    valid: Array,
) -> pd.DataFrame:
    """Score forecasts of outcomes against observed outcomes of the same scenarios.

    Args:
        forecast_outcomes: by name, the goal first: [S, K] bool, K ≥ 2, whether it happens.
        observed_outcomes: by the same names: [S, L] bool.
        forecast_by_step: [S, K, T] bool, whether the goal is reached by step 1 … T.
        observed_by_step: [S, L, T] bool, the same for rollouts.
        valid: [S, K] bool, which samples are finite.

    Raises:
        ValueError: no outcomes, names or shapes that do not match, or fewer than two samples.
    """
    _check(forecast_outcomes, observed_outcomes, forecast_by_step, observed_by_step, valid)
    goal = next(iter(forecast_outcomes))
    parts = _goal_rows(forecast_outcomes[goal], observed_outcomes[goal], valid)
    parts += _goal_by_step(forecast_by_step, observed_by_step, valid)
    for name in forecast_outcomes:
        dimension = "all" if name == goal else name
        parts += _outcome_rows(forecast_outcomes[name], observed_outcomes[name], valid, dimension)
    return pd.concat(parts, ignore_index=True)


def _outcome_rows(forecast: Array, observed: Array, valid: Array, name: str) -> list[pd.DataFrame]:
    """The rows that every outcome has."""
    plain, terms = brier(forecast, observed, valid), decompose(forecast, observed, valid)
    return [
        by_scenario("brier", plain, name),
        overall("brier", plain.mean(), name),
        overall("brier_fair", brier_fair(forecast, observed, valid).mean(), name),
        overall("brier_reliability", terms.reliability, name),
        overall("brier_resolution", terms.resolution, name),
        overall("brier_uncertainty", terms.uncertainty, name),
        overall("brier_climatology", climatology(observed).mean(), name),
        by_scenario("forecast_probability", (forecast & valid).mean(1), name),
        by_scenario("observed_probability", observed.mean(1), name),
    ]


def _goal_rows(forecast: Array, observed: Array, valid: Array) -> list[pd.DataFrame]:
    """The rows that only the goal has."""
    return [
        by_scenario("brier_fair", brier_fair(forecast, observed, valid)),
        by_scenario("brier_climatology", climatology(observed)),
        overall("brier_two_class", two_class(brier(forecast, observed, valid)).mean()),
    ]


def _goal_by_step(forecast: Array, observed: Array, valid: Array) -> list[pd.DataFrame]:
    success = forecast & valid[..., None]
    return [
        by_step("brier", brier(forecast, observed, valid).mean(0)),
        by_step("forecast_probability", success.mean((0, 1))),
        by_step("observed_probability", observed.mean((0, 1))),
    ]


def _check(
    forecast_outcomes: Mapping[str, Array],
    observed_outcomes: Mapping[str, Array],
    forecast_by_step: Array,
    observed_by_step: Array,
    valid: Array,
) -> None:
    if not forecast_outcomes or list(forecast_outcomes) != list(observed_outcomes):
        raise ValueError(
            f"outcomes {list(observed_outcomes)} were observed, {list(forecast_outcomes)} were "
            "forecast: give the same names, at least one"
        )
    scenarios, samples = np.shape(valid)
    rollouts, steps = np.shape(observed_by_step)[1:]
    of_samples, of_rollouts = (scenarios, samples), (scenarios, rollouts)
    shapes: list[tuple[str, Array, tuple[int, ...]]] = [
        ("forecast outcomes by step", forecast_by_step, (*of_samples, steps)),
        ("observed outcomes by step", observed_by_step, (*of_rollouts, steps)),
        *(
            (f"forecasts of {name!r}", values, of_samples)
            for name, values in forecast_outcomes.items()
        ),
        *(
            (f"rollouts of {name!r}", values, of_rollouts)
            for name, values in observed_outcomes.items()
        ),
    ]
    for what, values, expected in shapes:
        if np.shape(values) != expected:
            raise ValueError(f"{what} have shape {np.shape(values)}, not {expected}")
