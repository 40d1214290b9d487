"""The tidy table: its schema, its averages, and reading it back."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
import pytest

from study.metrics import brier as brier_module
from study.metrics.mmd import mmd
from study.metrics.tables import outcome_scores, trajectory_scores
from study.metrics.tables.scores import Outcomes, score
from study.metrics.tables.table import COLUMNS, select

S, K, L, T, D = 4, 6, 5, 3, 2
NAMES = ("x", "battery")
ONES = np.ones(D)


def inputs(seed: int = 0) -> dict[str, np.ndarray]:
    generator = np.random.default_rng(seed)
    return {
        "forecast": generator.normal(size=(S, K, T, D)).astype(np.float32),
        "observed": generator.normal(size=(S, L, T, D)).astype(np.float32),
        "forecast_by_step": np.logical_or.accumulate(generator.random((S, K, T)) < 0.3, axis=-1),
        "observed_by_step": np.logical_or.accumulate(generator.random((S, L, T)) < 0.3, axis=-1),
    }


def table(**changed: np.ndarray) -> pd.DataFrame:
    return score_of(inputs() | changed, NAMES)


def score_of(
    given: dict[str, np.ndarray], names: Sequence[str], member: np.ndarray | None = None
) -> pd.DataFrame:
    arrays = (given[name] for name in inputs())
    forecast, observed, forecast_by_step, observed_by_step = arrays
    outcomes = Outcomes(
        {"arrives": forecast_by_step[..., -1], "departs": forecast_by_step[..., 0]},
        {"arrives": observed_by_step[..., -1], "departs": observed_by_step[..., 0]},
        forecast_by_step,
        observed_by_step,
    )
    return score(
        forecast, observed, outcomes, ONES, ONES, names, member, reference_shifts=member is not None
    )


def expected_brier(given: dict[str, np.ndarray]) -> np.ndarray:
    last = (given[name][..., -1] for name in ("forecast_by_step", "observed_by_step"))
    return brier_module.brier(*last)


def overall(scores: pd.DataFrame, metric: str) -> float:
    rows = scores[
        (scores.metric == metric)
        & (scores.dimension == "all")
        & (scores.step == -1)
        & (scores.scenario == -1)
    ]
    return rows["value"].item()


def test_schema() -> None:
    scores = table()
    assert tuple(scores.columns) == COLUMNS
    assert scores["step"].dtype == np.int32
    assert scores["scenario"].dtype == np.int32
    assert scores["value"].dtype == np.float64
    assert not scores.duplicated(["metric", "dimension", "step", "scenario"]).any()
    counts = scores.groupby("metric").size().to_dict()
    own = {
        "mmd2": D * T + T * S + T + S + 1,
        "mmd": T + 1,
        "mmd2_half": T + S + 1,
        "mmd2_double": T + S + 1,
        "mmd2_joint": T + S + 1,
        "mmd2_pooled": D * T + T + 1,
        "variance_ratio": D * T + T + 1,
        "nonfinite": 1,
    }
    assert {metric: counts[metric] for metric in own} == own
    for module in (outcome_scores, trajectory_scores):
        for line in (module.__doc__ or "").splitlines():
            if line.startswith(("brier", "forecast_p", "crps", "energy", "aleatoric", "epistemic")):
                assert line.split()[0] in counts, line
    assert set(scores["step"]) == {-1, 1, 2, 3}
    assert set(scores["scenario"]) == {-1, 0, 1, 2, 3}
    assert set(scores["dimension"]) == {*NAMES, "all", "departs"}


def test_reference_shifts_have_their_closed_form() -> None:
    forecast = np.random.default_rng(1).normal(size=(400, 40, T, D)).astype(np.float32)
    observed = np.random.default_rng(2).normal(size=(400, 40, T, D)).astype(np.float32)
    outcome = np.zeros((400, 40, T), bool)
    given = {
        "forecast": forecast,
        "observed": observed,
        "forecast_by_step": outcome,
        "observed_by_step": outcome,
    }
    scores = score_of(given, NAMES, member=np.zeros((400, 40), int))
    marks = [overall(scores, f"mmd2_shift_{shift}") for shift in ("0.1", "0.3", "1")]
    # Two normals a apart, kernel of bandwidth 1: 2 (1/√3) (1 − exp(−a²/6)).
    expected = [2 / np.sqrt(3) * (1 - np.exp(-(a**2) / 6)) for a in (0.1, 0.3, 1.0)]
    # The standard deviation of 40 rollouts is 1 % low on average.
    np.testing.assert_allclose(marks, expected, atol=0.002, rtol=0.05)


def test_only_an_ensemble_has_an_epistemic_part() -> None:
    alone = score_of(inputs(), NAMES)
    assert overall(alone, "epistemic_share") == 0
    member = np.tile([0, 0, 0, 1, 1, 1], (S, 1))
    given = inputs()
    given["forecast"] = given["forecast"] + 9 * member[..., None, None]
    split = score_of(given, NAMES, member)
    assert overall(split, "epistemic_share") > 0.5
    assert overall(split, "aleatoric_ratio") < 0.2 * overall(split, "variance_ratio")
    assert "mmd2_shift_1" not in set(alone["metric"])


def test_values_are_those_of_the_metrics() -> None:
    given, scores = inputs(), table()
    squared = mmd(given["forecast"], given["observed"], ONES, ONES).squared
    chosen = scores[(scores.metric == "mmd2") & (scores.dimension == "battery")]
    np.testing.assert_allclose(chosen["value"], squared.mean(0)[:, 1])
    chosen = scores[(scores.metric == "mmd2") & (scores.step == 2) & (scores.scenario == 3)]
    assert chosen["value"].item() == pytest.approx(squared[3, 1].mean())
    chosen = scores[(scores.metric == "mmd2") & (scores.step == -1) & (scores.scenario == 1)]
    assert chosen["value"].item() == pytest.approx(squared[1].mean())
    assert overall(scores, "mmd2") == pytest.approx(squared.mean())
    expected = brier_module.brier(
        given["forecast_by_step"][..., -1], given["observed_by_step"][..., -1]
    )
    assert overall(scores, "brier") == pytest.approx(expected.mean())
    assert overall(scores, "brier_two_class") == pytest.approx(2 * expected.mean())


def test_non_finite_values_are_counted_and_penalised() -> None:
    forecast = inputs()["forecast"]
    forecast[0, 0, 0, 0] = np.nan
    forecast[1, 2, 1] = np.inf
    scores, before = table(forecast=forecast), table()
    assert overall(scores, "nonfinite") == pytest.approx(3 / forecast.size)
    assert overall(before, "nonfinite") == 0
    assert overall(scores, "brier") > overall(before, "brier")
    assert overall(scores, "mmd2") > overall(before, "mmd2")
    assert overall(scores, "brier_reliability") == -overall(scores, "brier_resolution") == np.inf
    assert overall(scores, "coverage_90") == -np.inf
    worst = {"variance_ratio", "aleatoric_ratio", "crps", "energy_score"}
    worst |= {"brier_reliability", "brier_resolution", "coverage_50", "coverage_80", "coverage_90"}
    assert overall(scores, "crps") == overall(scores, "energy_score") == np.inf
    known = scores[~scores.metric.isin({*worst, "epistemic_share"})]
    assert np.isfinite(known["value"]).all()


def test_a_dimension_without_variance_is_left_out_of_the_mean_ratio() -> None:
    observed = inputs()["observed"]
    observed[..., 0] = 1.0
    scores = table(observed=observed)
    by_step = scores[(scores.metric == "variance_ratio") & (scores.step > 0)]
    ratio = by_step.pivot(index="step", columns="dimension", values="value")
    assert ratio["x"].isna().all()
    np.testing.assert_allclose(ratio["all"], ratio["battery"])


def test_shapes_that_do_not_fit_are_named() -> None:
    with pytest.raises(ValueError, match="observed outcomes"):
        table(observed_by_step=np.ones((S, L + 1, T), bool))
    with pytest.raises(ValueError, match="observed rollouts"):
        table(observed=np.ones((S, L, T + 1, D), np.float32))
    with pytest.raises(ValueError, match="names"):
        score_of(inputs(), ["x"])


def cells() -> pd.DataFrame:
    frames = []
    for level, model, seed in (
        ("low", "full_vae", 0),
        ("low", "full_vae", 2),
        ("high", "full_vae", 0),
        ("low", "oracle", 0),
    ):
        cell = table(**inputs(seed))
        frames.append(cell.assign(environment="pusher", level=level, model=model, seed=seed))
    return pd.concat(frames, ignore_index=True)


def test_select_reads_back() -> None:
    scores = cells()
    found = select(scores, "brier", "pusher", "low", "full_vae")
    assert list(found.index) == [0, 2]
    assert list(found.columns) == [0, 1, 2, 3]
    given = inputs(2)
    expected = brier_module.brier(
        given["forecast_by_step"][..., -1], given["observed_by_step"][..., -1]
    )
    np.testing.assert_allclose(found.loc[2], expected)
    by_step = select(scores, "mmd2", "pusher", "low", "full_vae", by="step and scenario")
    assert by_step.shape == (2, T * S)
    np.testing.assert_allclose(
        by_step.T.groupby(level="scenario").mean().T,
        select(scores, "mmd2", "pusher", "low", "full_vae"),
    )


def test_select_of_nothing_is_empty() -> None:
    assert select(cells(), "brier", "uav", "low", "full_vae").empty
    assert select(cells(), "brier", "pusher", "low", "residual_vae").empty


def test_the_oracle_is_the_same_at_every_level() -> None:
    at_high = select(cells(), "brier", "pusher", "high", "oracle")
    pd.testing.assert_frame_equal(at_high, select(cells(), "brier", "pusher", "low", "oracle"))
