"""The rows of proper scores, calibration and variances: schema, averages, the oracle."""

import numpy as np
import pandas as pd
import pytest

from study.metrics.calibration import coverage, pit, rank_histogram
from study.metrics.proper_scores import crps, energy_score
from study.metrics.tables.table import COLUMNS
from study.metrics.tables.trajectory_scores import trajectory_rows
from study.metrics.variance import aleatoric_ratio, decompose, variance_ratio

S, K, L, T, D = 5, 12, 6, 4, 2
NAMES = ("x", "battery")
SCALE = np.array([1.0, 2.0])


def normal(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape, dtype=np.float32)


FORECAST, OBSERVED = normal(S, K, T, D), normal(S, L, T, D, seed=1)
MEMBER = np.random.default_rng(2).integers(0, 3, (S, K))


def value(
    rows: pd.DataFrame, metric: str, dimension: str = "all", step: int = -1, scenario: int = -1
) -> float:
    chosen = rows[
        (rows["metric"] == metric)
        & (rows["dimension"] == dimension)
        & (rows["step"] == step)
        & (rows["scenario"] == scenario)
    ]
    return float(chosen["value"].item())


def test_schema() -> None:
    rows = trajectory_rows(FORECAST, OBSERVED, SCALE, NAMES, MEMBER)
    assert tuple(rows.columns) == COLUMNS
    assert not rows.duplicated(["metric", "dimension", "step", "scenario"]).any()
    assert rows["value"].notna().all()
    assert rows.groupby("metric").size().to_dict() == {
        "crps": D + T + S + 1,
        "energy_score": T + S + 1,
        **dict.fromkeys(("coverage_50", "coverage_80", "coverage_90"), D + T + 1),
        **dict.fromkeys((f"pit_{i:02}" for i in range(1, 21)), D + 1),
        "variance_ratio": 1,
        "aleatoric_ratio": D * T + D + T + 1,
        "epistemic_share": D * T + T + 1,
    }


def test_values_are_those_of_the_metrics() -> None:
    rows = trajectory_rows(FORECAST, OBSERVED, SCALE, NAMES, MEMBER)
    marginal, joint = crps(FORECAST, OBSERVED, SCALE), energy_score(FORECAST, OBSERVED, SCALE)
    ranks = rank_histogram(FORECAST, OBSERVED)
    ratio = aleatoric_ratio(decompose(FORECAST, MEMBER), OBSERVED, SCALE)
    expected = {
        ("crps", "battery"): marginal[..., 1].mean(),
        ("crps", "all", 2): marginal[:, 1].mean(),
        ("crps", "all", -1, 3): marginal[3].mean(),
        ("crps",): marginal.mean(),
        ("energy_score", "all", 4): joint[:, 3].mean(),
        ("energy_score", "all", -1, 0): joint[0].mean(),
        ("energy_score",): joint.mean(),
        ("coverage_80", "x"): coverage(ranks, 0.8)[:, 0].mean(),
        ("coverage_50", "all", 1): coverage(ranks, 0.5)[0].mean(),
        ("coverage_90",): coverage(ranks, 0.9).mean(),
        ("pit_03", "battery"): pit(ranks)[:, 1, 2].mean(),
        ("pit_20",): pit(ranks)[..., 19].mean(),
        ("variance_ratio",): variance_ratio(FORECAST, OBSERVED, SCALE).mean(),
        ("aleatoric_ratio", "battery", 2): ratio[1, 1],
        ("aleatoric_ratio", "x"): ratio[:, 0].mean(),
        ("aleatoric_ratio", "all", 3): ratio[2].mean(),
    }
    for place, wanted in expected.items():
        assert value(rows, *place) == pytest.approx(wanted), place  # type: ignore[arg-type]


def test_the_oracle() -> None:
    centre = normal(400, 1, 3, 2, seed=5)
    forecast, observed = (centre + normal(400, 40, 3, 2, seed=s) for s in (6, 7))
    rows = trajectory_rows(forecast, observed, np.ones(2), NAMES)
    for level in (50, 80, 90):
        assert value(rows, f"coverage_{level}") == pytest.approx(level / 100, abs=0.01)
    for number in range(1, 21):
        assert value(rows, f"pit_{number:02}") == pytest.approx(0.05, abs=0.005)
    assert value(rows, "variance_ratio") == pytest.approx(1, abs=0.03)
    assert value(rows, "aleatoric_ratio") == pytest.approx(1, abs=0.03)
    assert value(rows, "epistemic_share") == 0
    assert value(rows, "crps") == pytest.approx(1 / np.sqrt(np.pi), abs=0.01)


def test_averages_with_a_non_finite_forecast_are_infinite() -> None:
    forecast = FORECAST.copy()
    forecast[1, 2, 3, 0] = np.nan
    rows = trajectory_rows(forecast, OBSERVED, SCALE, NAMES, MEMBER)
    before = trajectory_rows(FORECAST, OBSERVED, SCALE, NAMES, MEMBER)
    for metric in ("crps", "energy_score"):
        assert value(rows, metric) == np.inf
        assert value(rows, metric, scenario=1) == np.inf
        assert value(rows, metric, step=4) == np.inf
        assert value(rows, metric, step=3) == value(before, metric, step=3)
    assert value(rows, "crps", "battery") == value(before, "crps", "battery")
    assert value(rows, "aleatoric_ratio", "x", 4) == np.inf
    assert value(rows, "variance_ratio") == np.inf
    assert value(rows, "coverage_50", step=4) < value(before, "coverage_50", step=4)
    assert sum(value(rows, f"pit_{n:02}") for n in range(1, 21)) == pytest.approx(1)


def test_a_dimension_without_variance_is_left_out_of_the_ratios() -> None:
    observed = OBSERVED.copy()
    observed[..., 0] = 3.0
    rows = trajectory_rows(FORECAST, observed, SCALE, NAMES, MEMBER)
    assert np.isnan(value(rows, "aleatoric_ratio", "x"))
    assert value(rows, "aleatoric_ratio") == value(rows, "aleatoric_ratio", "battery")
