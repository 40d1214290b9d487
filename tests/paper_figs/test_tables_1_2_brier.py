"""Tables I and II: our values beside the paper's, failed and missing cells, new names."""

import re
from pathlib import Path

from paper_figs import tables_1_2_brier
from study.config.names import FULL
from tests.helpers.synthetic import scores


def test_our_values_are_beside_those_of_the_paper(results: Path) -> None:
    written = tables_1_2_brier.plot(results)
    names = ["brier_pusher.md", "brier_pusher.tex", "brier_uav.md", "brier_uav.tex"]
    assert [path.name for path in written] == names
    markdown, latex = (path.read_text() for path in written[:2])
    low = next(line for line in markdown.splitlines() if line.startswith("| Low"))
    entries = [entry.strip() for entry in low.strip("|").split("|")]
    assert re.fullmatch(r"\*\*0\.100\*\* \[0\.\d{3}, 0\.\d{3}\]<br>paper 0\.072", entries[1])
    assert [entry[:5] for entry in entries[2:]] == ["0.150", "0.350", "0.050", "0.170", "0.240"]
    assert "60 scenarios, 2 training seeds" in markdown
    assert "\\textbf{0.100}" in latex
    assert "\\quad paper & 0.072 & 0.391 & 0.416" in latex


def test_a_failed_cell_is_shown_with_the_value_of_the_paper(results: Path) -> None:
    pusher, _, uav, uav_tex = (path.read_text() for path in tables_1_2_brier.plot(results))
    high = next(line for line in uav.splitlines() if line.startswith("| High"))
    assert "| failed<br>paper 0.327 |" in high
    assert "failed" in uav_tex
    assert "failed" not in pusher


def test_a_missing_cell_is_not_called_failed(tmp_path: Path) -> None:
    table = scores(seeds=1)
    absent = (table.environment == "uav") & (table.model == FULL) & (table.level == "high")
    table[~absent].to_parquet(tmp_path / "scores.parquet")
    uav = tables_1_2_brier.plot(tmp_path)[2].read_text()
    assert "| —<br>paper 0.327 |" in uav
    assert "— not run." in uav
    assert "failed" not in uav


def test_latex_rows_have_the_declared_columns(results: Path) -> None:
    text = tables_1_2_brier.plot(results)[1].read_text()
    declared = re.search(r"begin\{tabular\}\{(\w+)\}", text)
    assert declared is not None
    lines = [line for line in text.splitlines() if line.endswith("\\\\")]
    assert {line.count("&") for line in lines} == {len(declared[1]) - 1}


def test_a_new_environment_and_a_new_model(new_names: Path) -> None:
    text = tables_1_2_brier.plot(new_names)[0].read_text()
    assert "Normalising flow" in text
    assert "paper" not in text
    assert "Full VAE" not in text
    assert "High" not in text
    assert "1 training seed;" in text
    assert "over scenarios only" in text
