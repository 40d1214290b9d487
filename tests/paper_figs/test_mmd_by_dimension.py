"""Heat maps of MMD²: their files and colours."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from paper_figs import mmd_by_dimension
from study.plotting import style
from tests.paper_figs.known_scores import MMD2
from tests.paper_figs.pictures import pixels_of, size_of


@pytest.fixture(scope="module")
def figures(forecast_results: Path) -> list[Path]:
    return mmd_by_dimension.plot(forecast_results)


def test_its_files(forecast_results: Path, figures: list[Path]) -> None:
    png, pdf = figures
    assert png == forecast_results / "figures" / "mmd_by_dimension_uav.png"
    assert pdf == png.with_suffix(".pdf")
    assert size_of(png)[0] == pytest.approx(300 * style.COLUMN_WIDTH, abs=2)
    assert b"/Type3" not in pdf.read_bytes()


@pytest.mark.parametrize("model", MMD2)
def test_each_value_has_its_colour(figures: list[Path], model: str) -> None:
    colours = mpl.colormaps[mmd_by_dimension.COLOURS]
    height = 300 * mmd_by_dimension.ROW
    for value in MMD2[model]:
        colour = colours(float(np.sqrt(max(value, 0) / 0.6)))
        # A row is at least one inch wide, at 300 dots an inch.
        assert pixels_of(figures[0], colour, 0.03) > 0.5 * height * 300


def test_a_new_environment_and_a_new_model(new_forecasts: Path) -> None:
    first = mmd_by_dimension.plot(new_forecasts)
    assert [path.name for path in first] == ["mmd_by_dimension_toy.png", "mmd_by_dimension_toy.pdf"]
    content = [path.read_bytes() for path in first]
    assert [path.read_bytes() for path in mmd_by_dimension.plot(new_forecasts)] == content
