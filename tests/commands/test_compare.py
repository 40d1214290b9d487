"""Cells side by side, from ``study.json`` and the tables of scores and trials."""

import json
from pathlib import Path

import pandas as pd
import pytest

from paper_figs import score_tables
from study.commands.compare import different_settings, scores
from study.common.errors import BadInput
from study.config.grid import Cell
from study.metrics.intervals import Interval
from study.metrics.variance import FIRST_STEP
from study.results import folder
from study.results.folder import Results
from study.run import main
from tests.helpers.recordings import scores as cell_scores
from tests.helpers.running import configuration

FIRST, SECOND = (Cell("pusher", "low", model, 0) for model in ("residual_vae", "full_vae"))
BETAS = {FIRST: 0.5, SECOND: 2.0}


@pytest.fixture
def results(tmp_path: Path) -> Results:
    """A results folder without recordings, of two cells, the second with scores twice as high."""
    tables, trials = [], []
    for factor, cell in enumerate((FIRST, SECOND), start=1):
        table = cell_scores().assign(**vars(cell))
        table["value"] *= factor
        tables.append(table)
        found = {"number": [0, 1], "beta": [7.0, BETAS[cell]], "chosen": [False, True]}
        trials.append(pd.DataFrame(found).assign(**vars(cell)))
    pd.concat(tables).to_parquet(tmp_path / "scores.parquet")
    pd.concat(trials).to_parquet(tmp_path / "trials.parquet")
    facts = {
        "format": folder.FORMAT,
        "settings": folder.settings_of(configuration("--vae.latent_size=3")),
        "cells": [FIRST.name, SECOND.name],
        "versions": {},
    }
    (tmp_path / "study.json").write_text(json.dumps(facts))
    return folder.read(tmp_path)


def test_the_settings_that_differ(results: Results) -> None:
    table = different_settings(results, [FIRST, SECOND])
    assert list(table.columns) == [FIRST.name, SECOND.name]
    assert list(table.loc["model"]) == ["residual_vae", "full_vae"]
    assert list(table.loc["beta"]) == [0.5, 2.0]
    # The full VAE has no ensemble. Both models have the settings of the VAEs.
    assert list(table.loc["ensemble.members"]) == [5, None]
    assert not [name for name in table.index if "latent_size" in name or "seed" in name]


def test_the_scores_are_aggregated_as_in_the_tables(results: Results) -> None:
    table = scores(results.out, [FIRST, SECOND])
    assert list(table.loc["plain Brier score"]) == [0.171, 0.342]
    every = pd.read_parquet(results.out / "scores.parquet")
    of_paper = score_tables.rows(every, "pusher", "low")
    for measure in score_tables.MEASURES:
        if measure.name in table.index:
            for cell in (FIRST, SECOND):
                entry = of_paper[measure.metric][cell.model]
                expected = entry.estimate if isinstance(entry, Interval) else entry
                assert table.loc[measure.name, cell.name] == pytest.approx(expected)
    ratio = every[(every.metric == "variance_ratio") & (every.dimension != "all")]
    median = ratio[(ratio.step >= FIRST_STEP) & (ratio.model == FIRST.model)].value.median()
    assert table.loc["forecast variance / true variance", FIRST.name] == pytest.approx(median)


def test_the_command_prints_both(results: Results, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", FIRST.name, SECOND.name, "--out", str(results.out)]) == 0
    text = capsys.readouterr().out
    for expected in (FIRST.name, SECOND.name, "beta", "plain Brier score", "0.171", "0.342"):
        assert expected in text


def test_a_cell_without_results_is_one_line(
    results: Results, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["compare", FIRST.name, "uav/low/full_vae/seed-0", "--out", str(results.out)]
    assert main(arguments) == BadInput.exit_code
    error = capsys.readouterr().err
    assert "has no cell 'uav/low/full_vae/seed-0'" in error
    assert error.count("\n") == 1
