"""Scores of forecast outcomes as rows of the tidy table (see `study.metrics.tables.table`).

The column `dimension` holds the name of an outcome; "all" is the headline, the goal itself.

==========================  =======================================================================
metric                      rows, of every outcome unless it says headline
==========================  =======================================================================
brier                       by scenario; all; headline by step: "has succeeded by step t"
brier_fair                  headline by scenario; all
brier_reliability           all: terms of the mean fair score, which is
brier_resolution            brier_reliability - brier_resolution + brier_uncertainty
brier_uncertainty
brier_climatology           headline by scenario; all
brier_two_class             headline, all
forecast_probability        by scenario: the share of samples that are finite and succeed; headline
                            by step: the mean over scenarios
observed_probability        by scenario: the share of rollouts that succeed; headline by step
==========================  =======================================================================

A sample that is not finite throughout is wrong at every step, as it is in the whole. An outcome
that always happens, or never, has an uncertainty and a climatology of 0: there is nothing to know,
and its skill is NaN. With one scenario the terms of the decomposition are NaN.
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
    """Score forecasts of outcomes against what was observed of the same scenarios.

    Args:
        forecast_outcomes: by name, the headline first: [S, K] bool, whether it happens, K ≥ 2.
        observed_outcomes: the same names: [S, L] bool.
        forecast_by_step: [S, K, T] bool, whether the headline has happened by step 1 … T.
        observed_by_step: [S, L, T] bool.
        valid: [S, K] bool, which samples are finite throughout.

    Raises:
        ValueError: no outcomes, other names, shapes that do not fit, or fewer than two samples.
    """
    _check(forecast_outcomes, observed_outcomes, forecast_by_step, observed_by_step, valid)
    headline, *others = forecast_outcomes
    parts = _of_headline(forecast_outcomes[headline], observed_outcomes[headline], valid)
    parts += _by_step(forecast_by_step, observed_by_step, valid)
    for name in (headline, *others):
        dimension = "all" if name == headline else name
        parts += _of_each(forecast_outcomes[name], observed_outcomes[name], valid, dimension)
    return pd.concat(parts, ignore_index=True)


def _of_each(forecast: Array, observed: Array, valid: Array, name: str) -> list[pd.DataFrame]:
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


def _of_headline(forecast: Array, observed: Array, valid: Array) -> list[pd.DataFrame]:
    """What only the headline has."""
    return [
        by_scenario("brier_fair", brier_fair(forecast, observed, valid)),
        by_scenario("brier_climatology", climatology(observed)),
        overall("brier_two_class", two_class(brier(forecast, observed, valid)).mean()),
    ]


def _by_step(forecast: Array, observed: Array, valid: Array) -> list[pd.DataFrame]:
    happens = forecast & valid[..., None]
    return [
        by_step("brier", brier(forecast, observed, valid).mean(0)),
        by_step("forecast_probability", happens.mean((0, 1))),
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
            f"outcomes {list(observed_outcomes)} were observed, {list(forecast_outcomes)} forecast"
        )
    scenarios, samples = np.shape(valid)
    rollouts, steps = np.shape(observed_by_step)[1:]
    of_samples, of_rollouts = (scenarios, samples), (scenarios, rollouts)
    given: list[tuple[str, Array, tuple[int, ...]]] = [
        ("forecast outcomes by step", forecast_by_step, (*of_samples, steps)),
        ("observed outcomes by step", observed_by_step, (*of_rollouts, steps)),
        *((f"forecasts of {name!r}", each, of_samples) for name, each in forecast_outcomes.items()),
        *((f"rollouts of {name!r}", each, of_rollouts) for name, each in observed_outcomes.items()),
    ]
    for what, values, fits in given:
        if np.shape(values) != fits:
            raise ValueError(f"{what} have shape {np.shape(values)}, not {fits}")
