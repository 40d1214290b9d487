"""Fig. 3: its files, its colours, and new names."""

from pathlib import Path

import pytest

from paper_figs import fig3_mmd
from study.config.names import MODELS
from study.plotting import style
from tests.paper_figs.pictures import pixels_of, size_of


@pytest.fixture(scope="module")
def figures(results: Path) -> list[Path]:
    return fig3_mmd.plot(results)


def test_one_figure_for_each_environment(results: Path, figures: list[Path]) -> None:
    assert [path.relative_to(results).as_posix() for path in figures] == [
        "figures/mmd_pusher.png",
        "figures/mmd_pusher.pdf",
        "figures/mmd_uav.png",
        "figures/mmd_uav.pdf",
    ]


def test_it_is_one_column_wide_with_text_as_text(figures: list[Path]) -> None:
    width, height = size_of(figures[0])
    assert width == pytest.approx(300 * style.COLUMN_WIDTH, abs=2)
    assert height < width
    # TrueType outlines: text in the PDF is text, and not Type 3 glyphs.
    pdf = figures[1].read_bytes()
    assert b"/Type3" not in pdf
    assert b"/TrueType" in pdf or b"/CIDFontType2" in pdf


@pytest.mark.parametrize("model", MODELS)
def test_every_model_is_visible(figures: list[Path], model: str) -> None:
    assert pixels_of(figures[0], style.COLOURS[model]) > 500


def test_the_same_scores_give_the_same_bytes(new_names: Path) -> None:
    first = [path.read_bytes() for path in fig3_mmd.plot(new_names)]
    assert [path.read_bytes() for path in fig3_mmd.plot(new_names)] == first


def test_a_new_environment_and_a_new_model(new_names: Path) -> None:
    png, pdf = fig3_mmd.plot(new_names)
    assert [png.name, pdf.name] == ["mmd_toy.png", "mmd_toy.pdf"]
    colour = style.colours(["normalising_flow"])["normalising_flow"]
    assert pixels_of(png, colour) > 200
