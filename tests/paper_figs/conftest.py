"""Results folders with known scores. Tests write figures and tables into them, and nothing else."""

from pathlib import Path

import pandas as pd
import pytest

from study.common.files import write_json
from study.config.names import FULL, LEVELS, ORACLE, RESIDUAL
from study.metrics.tables.table import CELL, COLUMNS
from tests.helpers.synthetic import scores
from tests.paper_figs.known_scores import (
    FORECASTERS,
    SAMPLES,
    cell_outcome_scores,
    write_forecast_scores,
)


@pytest.fixture(scope="session")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Synthetic scores of the paper's grid, of which one cell failed."""
    folder = tmp_path_factory.mktemp("results")
    table = scores(seeds=2)
    failed = (table.environment == "uav") & (table.model == FULL) & (table.level == "high")
    table[~failed].to_parquet(folder / "scores.parquet")
    write_json(folder / "study.json", {"failed": [f"uav/high/{FULL}/seed-1"]})
    return folder


@pytest.fixture
def new_names(tmp_path: Path) -> Path:
    """Synthetic scores of a new environment with a new model, at one level, with one seed."""
    table = scores(seeds=1)
    table = table[(table.environment == "uav") & (table.level == "low")]
    table = table.assign(environment="toy").replace({"model": {FULL: "normalising_flow"}})
    table.to_parquet(tmp_path / "scores.parquet")
    return tmp_path


@pytest.fixture(scope="session")
def forecast_results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scores of forecasts at two levels; one cell is missing, and the oracle has one level."""
    cells = [("uav", "low", RESIDUAL), ("uav", "high", RESIDUAL), ("uav", "low", FULL)]
    folder = tmp_path_factory.mktemp("forecasts")
    return write_forecast_scores(folder, [*cells, ("uav", "low", ORACLE)])


@pytest.fixture
def new_forecasts(tmp_path: Path) -> Path:
    """Scores of forecasts of a new model in a new environment, without references."""
    return write_forecast_scores(tmp_path, [("toy", "low", "normalising_flow")])


@pytest.fixture(scope="session")
def outcome_scores() -> pd.DataFrame:
    """Scores of outcomes of the UAV at two levels; the cell of the full VAE at high is missing."""
    cells = [
        cell_outcome_scores(model, seed).assign(
            environment="uav", level=level, model=model, seed=seed
        )
        for model in FORECASTERS
        for level in LEVELS
        for seed in range(2)
        if (model, level) != (FULL, "high")
    ]
    return pd.concat(cells, ignore_index=True)[[*CELL, *COLUMNS]]


@pytest.fixture(scope="session")
def outcome_results(outcome_scores: pd.DataFrame, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("outcomes")
    outcome_scores.to_parquet(folder / "scores.parquet")
    write_json(folder / "study.json", {"settings": {"collect": {"rollouts": SAMPLES}}})
    return folder


@pytest.fixture
def goal_results(outcome_scores: pd.DataFrame, tmp_path: Path) -> Path:
    """One level and seed of a new environment, with the goal only and without terms."""
    terms = ["brier_reliability", "brier_resolution", "brier_uncertainty"]
    chosen = outcome_scores[
        (outcome_scores.dimension == "all")
        & (outcome_scores.level == "low")
        & (outcome_scores.seed == 0)
        & ~outcome_scores.metric.isin(terms)
    ]
    chosen.assign(environment="toy").to_parquet(tmp_path / "scores.parquet")
    return tmp_path
