"""Tables of all scores; models beyond the paper in all tables."""

from pathlib import Path
from types import ModuleType

import pandas as pd
import pytest

from paper_figs import outcome_tables, score_tables, tables_1_2_brier
from study.config.names import FULL, ORACLE, RESIDUAL_CRPS
from tests.helpers.synthetic import AS_THE_PAPER, scores


@pytest.fixture
def score_results(tmp_path: Path) -> Path:
    table = scores(seeds=2)
    oracle = table[(table.model == ORACLE) & (table.metric == "mmd2") & (table.step == -1)]
    first = oracle.drop_duplicates(["environment", "level", "seed"])
    shifts = [
        first.assign(metric=f"mmd2_shift_{shift}", scenario=-1, value=value)
        for shift, value in (("0.1", 0.002), ("0.3", 0.017), ("1", 0.17))
    ]
    cell = (table.model == FULL) & (table.level == "high") & (table.environment == "uav")
    broken = first.assign(metric="nonfinite", scenario=-1, value=0.25, model=FULL)
    pd.concat([table[~cell], *shifts, broken]).to_parquet(tmp_path / "scores.parquet")
    return tmp_path


def test_rows_are_measures_and_columns_forecasters(score_results: Path) -> None:
    written = score_tables.plot(score_results)
    assert [path.name for path in written] == [
        "scores_pusher.md",
        "scores_pusher.tex",
        "scores_uav.md",
        "scores_uav.tex",
    ]
    pusher, uav = written[0].read_text(), written[2].read_text()
    low, high = pusher.split("## ")[1:]
    row = next(line for line in low.splitlines() if line.startswith("| MMD² |"))
    estimates = [entry.split("[")[0].strip() for entry in row.split("|")[3:-1]]
    assert estimates == ["0.0500", "0.1000", "0.3000", "0.0000", "0.1200"]
    assert "aleatoric variance / true variance" in high
    assert "CRPS |" not in high  # no cell has this score
    assert "0.0170 at 0.3" in pusher
    assert "60 scenarios, 2 training seeds" in pusher
    missing = next(line for line in uav.split("## ")[2].splitlines() if line.startswith("| MMD² |"))
    assert "| — |" in missing


def test_every_row_of_latex_has_as_many_columns(score_results: Path) -> None:
    text = score_tables.plot(score_results)[1].read_text()
    tables = text.split("\\begin{tabular}{")[1:]
    for table in tables:
        declared = len(table.split("}")[0])
        lines = [line for line in table.splitlines() if line.endswith("\\\\")]
        assert {line.count("&") for line in lines} == {declared - 1}
    assert "²" not in text


@pytest.mark.parametrize("tables", [score_tables, tables_1_2_brier, outcome_tables])
def test_models_beyond_the_paper_are_marked(tables: ModuleType, tmp_path: Path) -> None:
    beyond = {RESIDUAL_CRPS: (0.01, 0.02)}
    scores({**AS_THE_PAPER, **beyond}, seeds=1).to_parquet(tmp_path / "scores.parquet")
    markdown, tex = (path.read_text() for path in tables.plot(tmp_path)[:2])
    assert "esidual CRPS† |" in markdown
    assert "† Beyond the paper." in markdown
    assert "esidual CRPS\\textdagger{}" in tex
    assert "†" not in tex
    scores(seeds=1).to_parquet(tmp_path / "scores.parquet")
    assert "†" not in tables.plot(tmp_path)[0].read_text()
