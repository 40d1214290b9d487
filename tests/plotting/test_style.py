"""The line of a curve shows its level, and the files of a figure are always the same bytes."""

import re
from pathlib import Path

import matplotlib as mpl
import pytest

from study.config.names import ENSEMBLE, ORACLE, RESIDUAL
from study.plotting import lines, style


def test_the_line_shows_the_level() -> None:
    low, high = lines.line_of(RESIDUAL, "low"), lines.line_of(RESIDUAL, "high")
    assert not low.dashes
    assert high.dashes
    assert high.width < low.width
    assert style.line(RESIDUAL, "low") == {"linestyle": "-", "linewidth": low.width}
    assert style.line(RESIDUAL, "high")["linestyle"] == style.DASHES


def test_a_level_of_ones_own_has_a_pattern_of_its_own() -> None:
    dashes = {level: lines.line_of(RESIDUAL, level).dashes for level in ("low", "high", "tiny")}
    assert len(set(dashes.values())) == 3
    assert lines.line_of(RESIDUAL, "tiny") == lines.line_of(RESIDUAL, "tiny")
    assert lines.line_of(ORACLE, "tiny") == lines.line_of(ORACLE, "low")


def test_references_are_thin_and_the_oracle_has_no_level() -> None:
    assert lines.line_of(ORACLE, "high") == lines.line_of(ORACLE, "low")
    assert lines.line_of(ENSEMBLE, "low").width < lines.line_of(RESIDUAL, "low").width


def test_the_same_figure_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one", "other"):
        with mpl.rc_context(style.context()):
            figure = style.figure(height=1.0)
            figure.subplots().plot([0, 1], [0, 1], **style.line(RESIDUAL, "high"))
            style.save(figure, tmp_path / name)
    for suffix in (".png", ".pdf"):
        one, other = (tmp_path / f"{name}{suffix}" for name in ("one", "other"))
        assert one.read_bytes() == other.read_bytes()


def test_images_in_a_pdf_have_the_pixels_of_the_png(tmp_path: Path) -> None:
    with mpl.rc_context(style.context()):
        figure = style.figure(height=1.0)
        figure.add_axes((0, 0, 1, 1)).imshow([[0, 1]], aspect="auto")
        _, pdf = style.save(figure, tmp_path / "image")
    (width,) = re.findall(rb"/Width (\d+)", pdf.read_bytes())
    assert int(width) == pytest.approx(style.COLUMN_WIDTH * style.DPI, abs=2)
