"""Tables of outcomes: their blocks, values, failed cells, LaTeX, and results with the goal only."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from paper_figs import outcome_tables
from study.config.names import ENSEMBLE, FULL, MLP, ORACLE, RESIDUAL
from tests.paper_figs.known_scores import SAMPLES


def entries(text: str, section: str) -> list[list[str]]:
    """The rows of the table under a heading, without the header."""
    table = text.split(f"## {section}")[1].split("\n\n")[1]
    return [[entry.strip() for entry in line[1:-1].split("|")] for line in table.splitlines()[2:]]


def test_a_block_for_each_outcome(outcome_results: Path) -> None:
    written = outcome_tables.plot(outcome_results)
    assert [path.name for path in written] == ["outcomes_uav.md", "outcomes_uav.tex"]
    rows = entries(written[0].read_text(), "Low epistemic")
    forecasters = [row[1] for row in rows]
    block = [
        "residual VAE", "full VAE", "probabilistic MLP", "oracle", "ensemble alone", "climatology",
    ]  # fmt: skip
    assert forecasters == block * 3
    names = [row[0].split("**")[1] for row in rows if row[0]]
    assert names == ["Reaches the goal", "Keeps 20 % of charge", "Stays above 2 m"]
    # An outcome and its complement have equal scores. A certain outcome has no skill.
    assert [row[2:4] for row in rows[:6]] == [row[2:4] for row in rows[6:12]]
    assert {row[3] for row in rows[12:17]} == {"—"}
    # No model is bold in a tie.
    assert {row[2] for row in rows[12:17]} == {"0.000 [0.000, 0.000]"}


def test_values_are_those_of_the_scores(
    outcome_scores: pd.DataFrame, outcome_results: Path
) -> None:
    rows = entries(outcome_tables.plot(outcome_results)[0].read_text(), "Low epistemic")
    assert re.fullmatch(r"\*\*0\.\d{3}\*\* \[0\.\d{3}, 0\.\d{3}\]", rows[0][2])
    scores = outcome_scores
    chosen = scores[(scores.level == "low") & (scores.dimension == "all") & (scores.step == -1)]
    means = chosen[chosen.scenario == -1].groupby(["model", "metric"]).value.mean()
    for row, model in zip(rows[:5], (RESIDUAL, FULL, MLP, ORACLE, ENSEMBLE), strict=True):
        assert row[2].strip("*")[:5] == f"{means[model, 'brier']:.3f}"
        terms = [f"{means[model, f'brier_{term}']:.3f}" for term in ("reliability", "resolution")]
        assert [text.replace("−", "-") for text in row[4:]] == terms
    skills = [float(row[3].replace("−", "-")) for row in rows[:6]]
    assert skills[5] == 0
    assert skills[0] > skills[1] > skills[2]
    # The variance of the outcome is what an oracle that knows the probabilities expects.
    observed = chosen[(chosen.metric == "observed_probability") & (chosen.scenario >= 0)]
    share = observed[(observed.model == ORACLE) & (observed.seed == 0)].value
    oracle = (share * (1 - share)).mean() * SAMPLES / (SAMPLES - 1)
    reference = means[ORACLE, "brier_climatology"]
    for at, model in enumerate((RESIDUAL, FULL, MLP, ORACLE, ENSEMBLE)):
        expected = (reference - means[model, "brier_fair"]) / (reference - oracle)
        assert skills[at] == pytest.approx(expected, abs=0.005)
    assert skills[3] == pytest.approx(1, abs=0.1)


def test_a_study_that_lacks_the_number_of_rollouts_has_no_skill(
    outcome_scores: pd.DataFrame, tmp_path: Path
) -> None:
    outcome_scores.to_parquet(tmp_path / "scores.parquet")
    rows = entries(outcome_tables.plot(tmp_path)[0].read_text(), "Low epistemic")
    assert {row[3] for row in rows[:5]} == {"—"}


def test_a_forecast_that_is_not_finite_is_shown_as_such(
    outcome_scores: pd.DataFrame, tmp_path: Path
) -> None:
    table = outcome_scores.copy()
    lost = (table.model == FULL) & (table.seed == 0)
    table.loc[lost & (table.metric == "brier_reliability"), "value"] = np.inf
    table.loc[lost & (table.metric == "brier_resolution"), "value"] = -np.inf
    table.to_parquet(tmp_path / "scores.parquet")
    rows = entries(outcome_tables.plot(tmp_path)[0].read_text(), "Low epistemic")
    assert rows[1][4:] == ["∞", "−∞"]


def test_a_failed_cell_is_shown(outcome_results: Path) -> None:
    text, latex = (path.read_text() for path in outcome_tables.plot(outcome_results))
    assert entries(text, "High epistemic")[1][1:] == ["full VAE", "—", "—", "—", "—"]
    assert "the cell failed or did not run" in text
    assert "full VAE & --- &  & ---" in latex
    assert "60 scenarios, 2 training seeds" in text


def test_latex_rows_have_the_declared_columns(outcome_results: Path) -> None:
    text = outcome_tables.plot(outcome_results)[1].read_text()
    assert text.count("\\begin{table*}") == text.count("\\end{table*}") == 2
    declared = re.findall(r"begin\{tabular\}\{(\w+)\}", text)
    lines = [line for line in text.splitlines() if line.endswith("\\\\")]
    assert {line.count("&") for line in lines} == {len(declared[0]) - 1}
    assert "20\\,\\% of charge" in text
    assert not re.search(r"(?<!\\)%(?! needs)", text)
    assert "−" not in text


def test_the_goal_alone(goal_results: Path) -> None:
    text = outcome_tables.plot(goal_results)[0].read_text()
    assert len(entries(text, "Low epistemic")) == 6
    assert "Resolution" not in text
    assert "1 training seed;" in text


def test_scores_without_outcomes_have_no_table(
    outcome_scores: pd.DataFrame, tmp_path: Path
) -> None:
    outcome_scores.assign(metric="mmd2").to_parquet(tmp_path / "scores.parquet")
    assert outcome_tables.plot(tmp_path) == []
