"""Figures and tables are drawn from scores alone, the same ones each time."""

import re
import subprocess
import sys
from pathlib import Path

import matplotlib.image
import pandas as pd
import pytest

from paper_figs import fig3_mmd, tables_1_2_brier
from paper_figs.scores import read_scores
from study.common.errors import BadInput
from study.common.files import write_json
from study.config.names import FULL, MODELS
from study.plotting import style
from tests.helpers.synthetic import scores


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    table = scores(seeds=2)
    uav_full_high = (table.environment == "uav") & (table.model == FULL) & (table.level == "high")
    table[~uav_full_high].to_parquet(folder / "scores.parquet")
    write_json(folder / "study.json", {"failed": [f"uav/high/{FULL}/seed-1"]})
    return folder


@pytest.fixture(scope="module")
def drawn(results: Path) -> list[Path]:
    return fig3_mmd.plot(results)


@pytest.fixture
def another(tmp_path: Path) -> Path:
    """An environment and a model that the paper does not have, at one level, with one seed."""
    table = scores(seeds=1)
    table = table[(table.environment == "uav") & (table.level == "low")]
    table = table.assign(environment="toy").replace({"model": {FULL: "normalising_flow"}})
    table.to_parquet(tmp_path / "scores.parquet")
    return tmp_path


def test_mmd_curves(results: Path, drawn: list[Path]) -> None:
    assert [path.relative_to(results).as_posix() for path in drawn] == [
        "figures/mmd_pusher.png",
        "figures/mmd_pusher.pdf",
        "figures/mmd_uav.png",
        "figures/mmd_uav.pdf",
    ]
    height, width, _ = matplotlib.image.imread(drawn[0]).shape
    assert width == pytest.approx(300 * style.COLUMN_WIDTH, abs=2)
    assert height < width
    # TrueType outlines: text in the PDF is text, and not Type 3 glyphs.
    assert b"/Type3" not in drawn[1].read_bytes()
    assert b"/TrueType" in drawn[1].read_bytes() or b"/CIDFontType2" in drawn[1].read_bytes()


def test_every_model_has_its_colour_in_the_figure(drawn: list[Path]) -> None:
    picture = matplotlib.image.imread(drawn[0])[..., :3]
    for model in MODELS:
        red, green, blue = (int(style.COLOURS[model][i : i + 2], 16) / 255 for i in (1, 3, 5))
        near = abs(picture - (red, green, blue)).max(-1) < 0.01
        assert near.sum() > 500, model


def test_figures_are_the_same_each_time(another: Path) -> None:
    first = [path.read_bytes() for path in fig3_mmd.plot(another)]
    assert [path.read_bytes() for path in fig3_mmd.plot(another)] == first


def test_a_cell_that_was_not_run_is_told_from_one_that_failed(tmp_path: Path) -> None:
    table = scores(seeds=1)
    absent = (table.environment == "uav") & (table.model == FULL) & (table.level == "high")
    table[~absent].to_parquet(tmp_path / "scores.parquet")
    uav = tables_1_2_brier.plot(tmp_path)[2].read_text()
    assert "| —<br>paper 0.327 |" in uav
    assert "— not run." in uav
    assert "failed" not in uav


def test_brier_tables(results: Path) -> None:
    written = tables_1_2_brier.plot(results)
    names = ["brier_pusher.md", "brier_pusher.tex", "brier_uav.md", "brier_uav.tex"]
    assert [path.name for path in written] == names
    pusher, pusher_tex, uav, uav_tex = (path.read_text() for path in written)
    low = next(line for line in pusher.splitlines() if line.startswith("| Low"))
    entries = [entry.strip() for entry in low.strip("|").split("|")]
    assert re.fullmatch(r"\*\*0\.100\*\* \[0\.\d{3}, 0\.\d{3}\]<br>paper 0\.072", entries[1])
    assert [entry[:5] for entry in entries[2:]] == ["0.150", "0.350", "0.050", "0.170", "0.240"]
    assert "60 scenarios, 2 training seeds" in pusher
    assert "\\textbf{0.100}" in pusher_tex
    assert "\\quad paper & 0.072 & 0.391 & 0.416" in pusher_tex
    # The cell that failed is shown, with the paper's value, and explained.
    high = next(line for line in uav.splitlines() if line.startswith("| High"))
    assert "| failed<br>paper 0.327 |" in high
    assert "failed" in uav_tex
    assert "failed" not in pusher


def test_latex_rows_have_the_columns_they_declare(results: Path) -> None:
    text = tables_1_2_brier.plot(results)[1].read_text()
    declared = re.search(r"begin\{tabular\}\{(\w+)\}", text)
    assert declared is not None
    lines = [line for line in text.splitlines() if line.endswith("\\\\")]
    assert {line.count("&") for line in lines} == {len(declared[1]) - 1}


def test_an_environment_and_a_model_of_ones_own(another: Path) -> None:
    assert [path.name for path in fig3_mmd.plot(another)] == ["mmd_toy.png", "mmd_toy.pdf"]
    text = tables_1_2_brier.plot(another)[0].read_text()
    assert "Normalising flow" in text
    assert "paper" not in text
    assert "Full VAE" not in text
    assert "High" not in text
    assert "1 training seed;" in text
    assert "over scenarios only" in text


def test_colours_differ_and_never_change() -> None:
    palette = style.colours([*MODELS, "a", "b"])
    assert len(set(palette.values())) == len(palette)
    assert all(palette[model] == style.COLOURS[model] for model in style.COLOURS)


@pytest.mark.parametrize("spoil", ["no folder", "no file", "no table", "no column"])
def test_nothing_to_draw_from_is_one_clear_line(tmp_path: Path, spoil: str) -> None:
    folder = tmp_path / "none" if spoil == "no folder" else tmp_path
    if spoil == "no table":
        (folder / "scores.parquet").write_bytes(b"PAR1 and no more")
    if spoil == "no column":
        pd.DataFrame({"metric": ["mmd2"]}).to_parquet(folder / "scores.parquet")
    with pytest.raises(BadInput, match=r"run `python -m study\.run all` first") as caught:
        read_scores(folder)
    assert "\n" not in str(caught.value)


def test_command_line(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command(tables_1_2_brier.plot, "", [str(results)]) == 0
    assert all(Path(line).is_file() for line in capsys.readouterr().out.splitlines())


@pytest.mark.parametrize("script", ["mmd_curves", "brier_tables"])
def test_command_line_without_results(tmp_path: Path, script: str) -> None:
    line = [sys.executable, "-m", f"paper_figs.{script}", str(tmp_path / "none")]
    run = subprocess.run(line, capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert run.stderr.startswith("error: there is no folder")
    assert run.stderr.count("\n") == 1
    assert not (tmp_path / "none").exists()
