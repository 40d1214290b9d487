"""The rows of outcomes: their number, and their values against the metrics."""

from typing import Any

import numpy as np
import pandas as pd
import pytest

from study.metrics.brier import brier, brier_fair, climatology
from study.metrics.reliability import decompose
from study.metrics.tables.outcome_scores import outcome_rows
from study.metrics.tables.table import COLUMNS

GOAL, OTHER, ALWAYS = "reaches the target", "stays within reach", "keeps its charge"
SCENARIOS, SAMPLES, ROLLOUTS, STEPS = 12, 6, 5, 4


def inputs_of_outcomes() -> dict[str, Any]:
    generator = np.random.default_rng(0)
    true = generator.random(SCENARIOS)[:, None, None]

    def by_step(count: int) -> np.ndarray:
        happens = generator.random((SCENARIOS, count, STEPS)) < true / 2
        return np.logical_or.accumulate(happens, axis=-1)

    forecast, observed = by_step(SAMPLES), by_step(ROLLOUTS)
    return {
        "forecast_outcomes": {
            GOAL: forecast[..., -1],
            OTHER: ~forecast[..., 1],
            ALWAYS: np.ones((SCENARIOS, SAMPLES), bool),
        },
        "observed_outcomes": {
            GOAL: observed[..., -1],
            OTHER: ~observed[..., 1],
            ALWAYS: np.ones((SCENARIOS, ROLLOUTS), bool),
        },
        "forecast_by_step": forecast,
        "observed_by_step": observed,
        "valid": generator.random((SCENARIOS, SAMPLES)) < 0.9,
    }


def value(
    table: pd.DataFrame, metric: str, dimension: str = "all", step: int = -1, scenario: int = -1
) -> float:
    chosen = table[
        (table.metric == metric)
        & (table.dimension == dimension)
        & (table.step == step)
        & (table.scenario == scenario)
    ]
    assert len(chosen) == 1
    return float(chosen.value.iloc[0])


def test_the_number_of_rows_of_each_metric() -> None:
    table = outcome_rows(**inputs_of_outcomes())
    assert tuple(table.columns) == COLUMNS
    assert not table.duplicated(["metric", "dimension", "step", "scenario"]).any()
    counts = table.groupby(["metric", "dimension"]).size().unstack(fill_value=0)
    alone = {"brier_reliability": 1, "brier_resolution": 1, "brier_uncertainty": 1}
    expected_of_others = alone | {
        "brier": SCENARIOS + 1,
        "brier_fair": 1,
        "brier_climatology": 1,
        "brier_two_class": 0,
        "forecast_probability": SCENARIOS,
        "observed_probability": SCENARIOS,
    }
    expected_of_goal = alone | {
        "brier": SCENARIOS + 1 + STEPS,
        "brier_fair": SCENARIOS + 1,
        "brier_climatology": SCENARIOS + 1,
        "brier_two_class": 1,
        "forecast_probability": SCENARIOS + STEPS,
        "observed_probability": SCENARIOS + STEPS,
    }
    assert counts["all"].to_dict() == expected_of_goal
    assert counts[OTHER].to_dict() == counts[ALWAYS].to_dict() == expected_of_others


@pytest.mark.parametrize(("name", "dimension"), [(GOAL, "all"), (OTHER, OTHER)])
def test_values_are_those_of_the_metrics(name: str, dimension: str) -> None:
    inputs = inputs_of_outcomes()
    table = outcome_rows(**inputs)
    forecast, observed = inputs["forecast_outcomes"][name], inputs["observed_outcomes"][name]
    valid = inputs["valid"]
    score = brier(forecast, observed, valid)
    assert value(table, "brier", dimension) == pytest.approx(score.mean())
    assert value(table, "brier", dimension, scenario=7) == pytest.approx(score[7])
    fair = brier_fair(forecast, observed, valid)
    assert value(table, "brier_fair", dimension) == pytest.approx(fair.mean())
    assert value(table, "brier_reliability", dimension) == np.inf
    finite = outcome_rows(**inputs | {"valid": np.ones_like(valid)})
    terms = decompose(forecast, observed)
    assert value(finite, "brier_resolution", dimension) == pytest.approx(terms.resolution)
    summed = (
        value(finite, "brier_reliability", dimension)
        - value(finite, "brier_resolution", dimension)
        + value(finite, "brier_uncertainty", dimension)
    )
    assert summed == pytest.approx(brier_fair(forecast, observed).mean())
    base = climatology(observed).mean()
    assert value(table, "brier_climatology", dimension) == pytest.approx(base)
    share = (forecast & valid).mean(1)[3]
    assert value(table, "forecast_probability", dimension, scenario=3) == pytest.approx(share)


def test_by_step_ends_at_the_goal() -> None:
    inputs = inputs_of_outcomes()
    table = outcome_rows(**inputs)
    assert value(table, "brier", step=STEPS) == pytest.approx(value(table, "brier"))
    observed = inputs["observed_outcomes"][GOAL]
    found = value(table, "observed_probability", step=STEPS)
    assert found == pytest.approx(observed.mean())
    shares = [value(table, "forecast_probability", step=t) for t in range(1, STEPS + 1)]
    assert shares == sorted(shares)
    first = inputs["forecast_by_step"][..., 0], inputs["observed_by_step"][..., 0]
    assert value(table, "brier", step=1) == pytest.approx(brier(*first, inputs["valid"]).mean())


def test_an_outcome_that_always_happens() -> None:
    inputs = inputs_of_outcomes() | {"valid": np.ones((SCENARIOS, SAMPLES), bool)}
    table = outcome_rows(**inputs)
    for metric in ("brier", "brier_fair", "brier_climatology", "brier_uncertainty"):
        assert value(table, metric, ALWAYS) == pytest.approx(0, abs=1e-12)


def test_names_and_shapes_that_do_not_match_are_refused() -> None:
    inputs = inputs_of_outcomes()
    renamed = dict(zip(("a", "b", "c"), inputs["observed_outcomes"].values(), strict=True))
    with pytest.raises(ValueError, match="were observed"):
        outcome_rows(**inputs | {"observed_outcomes": renamed})
    short = inputs["forecast_outcomes"] | {OTHER: inputs["forecast_outcomes"][OTHER][:, :-1]}
    with pytest.raises(ValueError, match="forecasts of 'stays within reach'"):
        outcome_rows(**inputs | {"forecast_outcomes": short})
    with pytest.raises(ValueError, match="forecast outcomes by step"):
        outcome_rows(**inputs | {"forecast_by_step": inputs["forecast_by_step"][..., :-1]})
    with pytest.raises(ValueError, match="were observed"):
        outcome_rows(**inputs | {"forecast_outcomes": {}, "observed_outcomes": {}})
