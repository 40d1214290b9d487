"""``scores.rrd`` holds the same numbers as the table of scores."""

from pathlib import Path

import numpy as np

from study.recording.scores import record_scores, reliability
from tests.helpers import reading, recordings


def test_scores_are_the_same_numbers(tmp_path: Path) -> None:
    table, path = recordings.scores(), tmp_path / "scores.rrd"
    record_scores(path, table, recordings.PROPERTIES)
    stepwise = table[(table["step"] > 0) & (table["scenario"] < 0)]
    for (metric, dimension), rows in stepwise.groupby(["metric", "dimension"]):
        frame = reading.scalars(path, f"/{metric}/{dimension}")
        assert list(frame.index) == list(rows["step"])
        assert list(frame["value"]) == list(rows["value"])
    rows = table[table["metric"] == "forecast_probability"]
    frame = reading.scalars(path, "/by_scenario/forecast_probability")
    assert list(frame["value"]) == list(rows["value"])
    assert reading.scalars(path, "/overall/brier/all")["value"].tolist() == [0.171]
    rows = table[
        (table["metric"] == "mmd2") & (table["step"] == -1) & (table["dimension"] != "all")
    ]
    by_dimension = reading.scalars(path, "/overall/mmd2/dimensions")
    assert by_dimension.iloc[0].to_dict() == dict(
        zip(rows["dimension"], rows["value"], strict=True)
    )


def test_bins_of_the_reliability_diagram() -> None:
    forecast = np.array([0.02, 0.04, 0.55, 1.0])
    observed = np.array([0.0, 0.1, 0.5, 0.9])
    probability, frequency = reliability(forecast, observed)
    np.testing.assert_allclose(probability, [0.03, 0.55, 1.0])
    np.testing.assert_allclose(frequency, [0.05, 0.5, 0.9])
