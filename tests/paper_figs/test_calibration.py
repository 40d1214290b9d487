"""Figures of calibration: their files and colours, and results without coverage."""

from pathlib import Path

import pandas as pd
import pytest

from paper_figs import calibration
from study.plotting import style
from tests.paper_figs.known_scores import MMD2
from tests.paper_figs.pictures import pixels_of, size_of


@pytest.fixture(scope="module")
def figures(forecast_results: Path) -> list[Path]:
    return calibration.plot(forecast_results)


def test_its_files(forecast_results: Path, figures: list[Path]) -> None:
    png, pdf = figures
    assert png == forecast_results / "figures" / "calibration_uav.png"
    assert pdf == png.with_suffix(".pdf")
    assert size_of(png)[0] == pytest.approx(300 * style.COLUMN_WIDTH, abs=2)
    assert b"/Type3" not in pdf.read_bytes()


@pytest.mark.parametrize("model", MMD2)
def test_every_model_is_visible(figures: list[Path], model: str) -> None:
    assert pixels_of(figures[0], style.COLOURS[model]) > 200


def test_a_new_environment_and_a_new_model(new_forecasts: Path) -> None:
    paths = calibration.plot(new_forecasts)
    assert [path.name for path in paths] == ["calibration_toy.png", "calibration_toy.pdf"]


def test_results_without_coverage_have_no_figure(new_forecasts: Path) -> None:
    table = pd.read_parquet(new_forecasts / "scores.parquet")
    kept = ~table["metric"].str.startswith(("coverage_", "pit_"))
    table[kept].to_parquet(new_forecasts / "scores.parquet")
    assert calibration.plot(new_forecasts) == []
    assert not (new_forecasts / "figures").exists()
