"""Figures of variance ratios: their lines, missing metrics, infinite ratios."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from paper_figs import variance_ratio
from study.config.names import FULL
from study.plotting import style
from tests.paper_figs.known_scores import MMD2
from tests.paper_figs.pictures import pixels_of, size_of


@pytest.fixture(scope="module")
def figures(forecast_results: Path) -> list[Path]:
    return variance_ratio.plot(forecast_results)


def test_its_files(forecast_results: Path, figures: list[Path]) -> None:
    png, pdf = figures
    assert png == forecast_results / "figures" / "variance_uav.png"
    assert pdf == png.with_suffix(".pdf")
    assert size_of(png)[0] == pytest.approx(300 * style.COLUMN_WIDTH, abs=2)
    assert b"/Type3" not in pdf.read_bytes()


@pytest.mark.parametrize("model", MMD2)
def test_every_model_is_visible(figures: list[Path], model: str) -> None:
    assert pixels_of(figures[0], style.COLOURS[model]) > 200


def test_a_new_environment_and_a_new_model(new_forecasts: Path) -> None:
    paths = variance_ratio.plot(new_forecasts)
    assert [path.name for path in paths] == ["variance_toy.png", "variance_toy.pdf"]


def test_without_the_aleatoric_ratio_the_total_is_shown(new_forecasts: Path) -> None:
    colour = style.colours(["normalising_flow"])["normalising_flow"]
    expected = pixels_of(variance_ratio.plot(new_forecasts)[0], colour)
    assert expected > 200
    table = pd.read_parquet(new_forecasts / "scores.parquet")
    table[table.metric != "aleatoric_ratio"].to_parquet(new_forecasts / "scores.parquet")
    # Without an ensemble the two ratios are equal, and so are their lines.
    without = pixels_of(variance_ratio.plot(new_forecasts)[0], colour)
    assert without == pytest.approx(expected, rel=0.1)


def test_a_curve_ends_where_one_dimension_of_one_seed_is_not_finite(forecast_results: Path) -> None:
    table = pd.read_parquet(forecast_results / "scores.parquet")
    lost = (table.metric == "aleatoric_ratio") & (table.dimension == "speed") & (table.seed == 1)
    table.loc[lost & (table.model == FULL) & (table.step > 3), "value"] = np.inf
    ratios = variance_ratio._by_step(table, "aleatoric_ratio", "uav", "low", FULL)
    axes = Figure().subplots()
    variance_ratio._curve(axes, ratios)
    curve = np.asarray(axes.lines[0].get_ydata())
    np.testing.assert_array_equal(np.isinf(curve), [False] * 3 + [True] * 3)
    places = table[(table.metric == "aleatoric_ratio") & (table.model == FULL)]
    first = places[(places.dimension != "all") & (places.step == 1)].value
    assert curve[0] == np.median(first)


def test_infinite_and_undefined_ratios_are_left_out(new_forecasts: Path) -> None:
    colour = style.colours(["normalising_flow"])["normalising_flow"]
    whole = pixels_of(variance_ratio.plot(new_forecasts)[0], colour)
    table = pd.read_parquet(new_forecasts / "scores.parquet")
    ratio = table["metric"].isin(["aleatoric_ratio", "variance_ratio"])
    table.loc[ratio & (table["step"] > 3), "value"] = np.inf
    table.loc[ratio & (table["step"] == 1), "value"] = np.nan
    table.to_parquet(new_forecasts / "scores.parquet")
    assert 0 < pixels_of(variance_ratio.plot(new_forecasts)[0], colour) < whole
