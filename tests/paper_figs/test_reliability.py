"""Reliability diagrams and tables of outcomes, from scores of forecasters that are known."""

import re
from pathlib import Path

import matplotlib.image
import numpy as np
import pandas as pd
import pytest

from paper_figs import outcome_tables, reliability
from study.common.errors import BadInput
from study.config.names import ENSEMBLE, FULL, LEVELS, MLP, ORACLE, RESIDUAL
from study.metrics.tables.outcome_scores import outcome_rows
from study.metrics.tables.table import CELL, COLUMNS
from study.plotting import style

SCENARIOS, SAMPLES, ROLLOUTS = 60, 12, 12
OTHER, ALWAYS = "keeps 20 % of charge", "stays_above 2 m"
MODELS = (RESIDUAL, FULL, MLP, ENSEMBLE, ORACLE)


def cell(model: str, seed: int) -> pd.DataFrame:
    """The oracle knows every probability; of a model the share of scenarios it mistakes grows."""
    true = np.random.default_rng(7).beta(0.8, 0.8, SCENARIOS)
    generator = np.random.default_rng([seed, len(model)])
    mistaken = {ORACLE: 0.0, RESIDUAL: 0.1, FULL: 0.4, ENSEMBLE: 0.6, MLP: 0.8}[model]
    issued = np.where(generator.random(SCENARIOS) < mistaken, 1 - true, true)
    observer = np.random.default_rng(8)
    forecast = generator.random((SCENARIOS, SAMPLES)) < issued[:, None]
    observed = observer.random((SCENARIOS, ROLLOUTS)) < true[:, None]
    return outcome_rows(
        {"reaches the target": forecast, OTHER: ~forecast, ALWAYS: np.ones_like(forecast)},
        {"reaches the target": observed, OTHER: ~observed, ALWAYS: np.ones_like(observed)},
        forecast[..., None],
        observed[..., None],
        np.ones_like(forecast),
    )


@pytest.fixture(scope="module")
def scores() -> pd.DataFrame:
    """Two levels of the UAV; the full VAE's cell at the level high has failed."""
    cells = [
        cell(model, seed).assign(environment="uav", level=level, model=model, seed=seed)
        for model in MODELS
        for level in LEVELS
        for seed in range(2)
        if (model, level) != (FULL, "high")
    ]
    return pd.concat(cells, ignore_index=True)[[*CELL, *COLUMNS]]


@pytest.fixture(scope="module")
def results(scores: pd.DataFrame, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    scores.to_parquet(folder / "scores.parquet")
    return folder


@pytest.fixture(scope="module")
def drawn(results: Path) -> list[Path]:
    return reliability.plot(results)


def entries(text: str, section: str) -> list[list[str]]:
    """The rows of the table under a heading, without its head."""
    table = text.split(f"## {section}")[1].split("\n\n")[1]
    return [[e.strip() for e in line[1:-1].split("|")] for line in table.splitlines()[2:]]


def test_diagram_has_a_column_and_the_models_their_colours(drawn: list[Path]) -> None:
    assert [path.name for path in drawn] == ["reliability_uav.png", "reliability_uav.pdf"]
    picture = matplotlib.image.imread(drawn[0])[..., :3]
    assert picture.shape[1] == pytest.approx(300 * style.COLUMN_WIDTH, abs=2)
    for model in MODELS:
        red, green, blue = (int(style.COLOURS[model][i : i + 2], 16) / 255 for i in (1, 3, 5))
        near = abs(picture - (red, green, blue)).max(-1) < 0.01
        assert near.sum() > 500, model
    assert b"/Type3" not in drawn[1].read_bytes()


def test_diagram_is_the_same_each_time(results: Path, drawn: list[Path]) -> None:
    first = [path.read_bytes() for path in drawn]
    assert [path.read_bytes() for path in reliability.plot(results)] == first


def test_table_has_a_block_for_each_outcome(results: Path) -> None:
    written = outcome_tables.plot(results)
    assert [path.name for path in written] == ["outcomes_uav.md", "outcomes_uav.tex"]
    rows = entries(written[0].read_text(), "Low epistemic")
    forecasters = [row[1] for row in rows]
    once = [
        "residual VAE", "full VAE", "probabilistic MLP", "oracle", "ensemble alone", "climatology",
    ]  # fmt: skip
    assert forecasters == once * 3
    names = [row[0].split("**")[1] for row in rows if row[0]]
    assert names == ["The task succeeds", "Keeps 20 % of charge", "Stays above 2 m"]
    # An outcome and its opposite are equally hard; one that always happens leaves nothing to know.
    assert [row[2:4] for row in rows[:6]] == [row[2:4] for row in rows[6:12]]
    assert {row[3] for row in rows[12:17]} == {"—"}
    # Of all that tie, none is bold.
    assert {row[2] for row in rows[12:17]} == {"0.000 [0.000, 0.000]"}


def test_table_gives_what_was_scored(scores: pd.DataFrame, results: Path) -> None:
    rows = entries(outcome_tables.plot(results)[0].read_text(), "Low epistemic")
    assert re.fullmatch(r"\*\*0\.\d{3}\*\* \[0\.\d{3}, 0\.\d{3}\]", rows[0][2])
    chosen = scores[(scores.level == "low") & (scores.dimension == "all") & (scores.step == -1)]
    means = chosen[chosen.scenario == -1].groupby(["model", "metric"]).value.mean()
    for row, model in zip(rows[:5], (RESIDUAL, FULL, MLP, ORACLE, ENSEMBLE), strict=True):
        assert row[2].strip("*")[:5] == f"{means[model, 'brier']:.3f}"
        terms = [f"{means[model, f'brier_{term}']:.3f}" for term in ("reliability", "resolution")]
        assert [text.replace("−", "-") for text in row[4:]] == terms
    skills = [float(row[3].replace("−", "-")) for row in rows[:6]]
    assert skills[3] == 1
    assert skills[5] == 0
    assert skills[0] > skills[1] > skills[2]


def test_a_cell_that_failed_is_shown(results: Path) -> None:
    text, latex = (path.read_text() for path in outcome_tables.plot(results))
    assert entries(text, "High epistemic")[1][1:] == ["full VAE", "—", "—", "—", "—"]
    assert "the cell failed or was not run" in text
    assert "full VAE & --- &  & ---" in latex
    assert "60 scenarios, 2 training seeds" in text


def test_latex_is_whole(results: Path) -> None:
    text = outcome_tables.plot(results)[1].read_text()
    assert text.count("\\begin{table*}") == text.count("\\end{table*}") == 2
    declared = re.findall(r"begin\{tabular\}\{(\w+)\}", text)
    lines = [line for line in text.splitlines() if line.endswith("\\\\")]
    assert {line.count("&") for line in lines} == {len(declared[0]) - 1}
    assert "20\\,\\% of charge" in text
    assert not re.search(r"(?<!\\)%(?! needs)", text)
    assert "−" not in text


def test_headline_alone(scores: pd.DataFrame, tmp_path: Path) -> None:
    """One level and seed of an environment of one's own, without other outcomes and terms."""
    terms = ["brier_reliability", "brier_resolution", "brier_uncertainty"]
    chosen = scores[
        (scores.dimension == "all")
        & (scores.level == "low")
        & (scores.seed == 0)
        & ~scores.metric.isin(terms)
    ].assign(environment="toy")
    chosen.to_parquet(tmp_path / "scores.parquet")
    assert [path.name for path in reliability.plot(tmp_path)] == [
        "reliability_toy.png",
        "reliability_toy.pdf",
    ]
    text = outcome_tables.plot(tmp_path)[0].read_text()
    assert len(entries(text, "Low epistemic")) == 6
    assert "Resolution" not in text
    assert "1 training seed;" in text


@pytest.mark.parametrize("draw", [reliability.plot, outcome_tables.plot])
def test_nothing_to_draw_from(tmp_path: Path, draw: object) -> None:
    assert callable(draw)
    with pytest.raises(BadInput):
        draw(tmp_path)


def test_scores_without_outcomes_draw_nothing(scores: pd.DataFrame, tmp_path: Path) -> None:
    scores.assign(metric="mmd2").to_parquet(tmp_path / "scores.parquet")
    assert reliability.plot(tmp_path) == outcome_tables.plot(tmp_path) == []
