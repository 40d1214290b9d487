"""``study.rrd`` holds the same numbers as the scores of its cells."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from study.config.grid import Cell
from study.metrics.tables.table import select
from study.metrics.variance import FIRST_STEP
from study.recording.integrity import check
from study.recording.study import record_study
from tests.helpers import reading, recordings
from tests.helpers.reading import document

PROPERTIES = {"study": "toy", "seeds": "0", "config": '{"name": "toy"}'}


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("study") / "recordings" / "study.rrd"
    beside = path.parent / "puck/low/full_vae/seed-0"
    beside.mkdir(parents=True)
    for name in ("forecast.rrd", "forecast.rrd.sha256", "tuning.rrd"):
        (beside / name).touch()
    record_study(path, recordings.study_scores(), recordings.TEXTS, PROPERTIES)
    return path


def _cells(table: pd.DataFrame) -> list[Cell]:
    columns = ["environment", "level", "model", "seed"]
    return [Cell(*row) for row in table[columns].drop_duplicates().itertuples(index=False)]


def same_numbers(path: Path, table: pd.DataFrame) -> None:
    """Every cell's curve and overall scores are those of the table."""
    whole = table[(table["dimension"] == "all") & (table["scenario"] == -1)].set_index(
        ["environment", "level", "model", "seed"]
    )
    curves = reading.scalars_below(path, "/mmd2")
    assert set(curves) == {f"/mmd2/{cell.name}" for cell in _cells(table)}
    for cell in _cells(table):
        of_cell = whole.loc[[(cell.environment, cell.level, cell.model, cell.seed)]]
        rows = of_cell[(of_cell["metric"] == "mmd2") & (of_cell["step"] > 0)].sort_values("step")
        curve = curves[f"/mmd2/{cell.name}"]
        assert curve.index.name == "horizon"
        assert list(curve.index) == list(rows["step"])
        assert list(curve["value"]) == list(rows["value"])
        for metric in ("mmd2", "brier"):
            rows = of_cell[(of_cell["metric"] == metric) & (of_cell["step"] == -1)]
            overall = reading.scalars(path, f"/overall/{metric}")[cell.name]
            assert overall.item() == rows["value"].item()
        names = (cell.environment, cell.level, cell.model)
        ratio = select(table, "variance_ratio", *names, by="dimension and step").loc[cell.seed]
        median = ratio[ratio.index.get_level_values("step") >= FIRST_STEP].median()
        assert reading.scalars(path, "/overall/variance_ratio")[cell.name].item() == median


def test_the_same_numbers_as_in_the_scores(path: Path) -> None:
    same_numbers(path, recordings.study_scores())
    check(path)


def test_the_mmd2_of_shifted_forecasts_is_recorded(path: Path) -> None:
    table = recordings.study_scores()
    shifted = (table["environment"] == "sledge") & (table["metric"] == "mmd2_shift_1")
    mean = table[shifted & (table["step"] > 0)].groupby("step")["value"].mean()
    recorded = reading.scalars(path, "/reference_shift/sledge/mmd2_shift_1")["value"]
    np.testing.assert_allclose(recorded, mean)


def test_properties_are_read_back(path: Path) -> None:
    assert reading.properties(path) == PROPERTIES


def test_recordings_of_cells_are_listed(path: Path) -> None:
    text = document(path, "/text/Cells")
    (row,) = [line for line in text.splitlines() if "puck/low/full_vae/seed-0" in line]
    assert row.endswith("| forecast, tuning |")
    assert sum(line.endswith("| none |") for line in text.splitlines()) == 15


def test_texts_are_recorded_without_html(path: Path) -> None:
    assert document(path, "/text/Claims") == recordings.TEXTS["Claims"]
    assert "| low | **0.2** · paper 0.3 |" in document(path, r"/text/Brier\ scores")


def test_the_legend_names_the_colour_of_each_model(path: Path) -> None:
    lines = document(path, "/legend").splitlines()
    for colour, model in (("blue", "residual VAE"), ("teal", "drift"), ("grey", "oracle")):
        assert f"- {colour}: **{model}**" in lines


def test_several_seeds_and_values_that_are_not_finite(tmp_path: Path) -> None:
    table = recordings.study_scores(seeds=3)
    worst = (table["metric"] == "mmd2") & (table["step"] == 5) & (table["seed"] == 1)
    table.loc[worst, "value"] = np.inf
    record_study(tmp_path / "study.rrd", table, {}, {})
    curve = reading.scalars(tmp_path / "study.rrd", "/mmd2/puck/high/drift/seed-1")["value"]
    assert np.isnan(curve[5])
    assert np.isfinite(curve.drop(5)).all()
