"""Scores of forecasts and outcomes with known properties."""

from pathlib import Path

import numpy as np
import pandas as pd

from study.config.names import ENSEMBLE, FULL, MLP, ORACLE, RESIDUAL
from study.metrics.tables.outcome_scores import outcome_rows
from study.metrics.tables.table import by_dimension_and_step
from study.metrics.tables.trajectory_scores import trajectory_rows
from study.metrics.variance import variance_ratio

NAMES = ("heading", "speed", "battery")
MMD2 = {RESIDUAL: (0.02, 0.05, 0.3), FULL: (0.3, 0.1, 0.6), ORACLE: (0.0, 0.0, -0.001)}
"""MMD² of each dimension at every step, by model."""
DEVIATION = {RESIDUAL: 1.2, FULL: 0.4, ORACLE: 1.0}
"""Standard deviation of the forecasts, by model; that of observed rollouts is 1."""


FORECASTERS = (RESIDUAL, FULL, MLP, ENSEMBLE, ORACLE)
SAMPLES = 12
"""Forecasts, and observed rollouts, of each scenario."""
COMPLEMENT, CERTAIN = "keeps 20 % of charge", "stays_above 2 m"


def write_forecast_scores(folder: Path, cells: list[tuple[str, str, str]]) -> Path:
    """Write the scores of forecasts with known variances, for two seeds of each cell."""
    table = pd.concat(
        [
            _forecast_scores(model).assign(
                environment=environment, level=level, model=model, seed=seed
            )
            for environment, level, model in cells
            for seed in (0, 1)
        ],
        ignore_index=True,
    )
    table.to_parquet(folder / "scores.parquet")
    return folder


def _forecast_scores(model: str, steps: int = 6) -> pd.DataFrame:
    generator = np.random.default_rng(sum(map(ord, model)))
    observed = generator.normal(size=(20, 12, steps, 3)).astype(np.float32)
    noise = generator.normal(size=observed.shape).astype(np.float32)
    forecast = DEVIATION.get(model, 2.0) * noise
    member = generator.integers(0, 3, forecast.shape[:2]) if model == RESIDUAL else None
    if member is not None:
        forecast += 0.8 * (member - 1)[:, :, None, None]
    names, unit = np.array([*NAMES, "all"], object), np.ones(3)
    mmd2 = np.tile(MMD2.get(model, (0.1, 0.1, 0.1)), (steps, 1))
    ratio = variance_ratio(forecast, observed, unit)
    return pd.concat(
        [
            trajectory_rows(forecast, observed, unit, NAMES, member),
            by_dimension_and_step("variance_ratio", ratio, names),
            by_dimension_and_step("mmd2", mmd2, names),
        ]
    )


def cell_outcome_scores(
    model: str, seed: int, scenarios: int = 60, samples: int = SAMPLES
) -> pd.DataFrame:
    """The oracle forecasts the true probabilities; other models are wrong in some scenarios.

    The goal has a complement and comes with an outcome that always happens.
    """
    true = np.random.default_rng(7).beta(0.8, 0.8, scenarios)
    generator = np.random.default_rng([seed, len(model)])
    wrong = {ORACLE: 0.0, RESIDUAL: 0.1, FULL: 0.4, ENSEMBLE: 0.6, MLP: 0.8}[model]
    probability = np.where(generator.random(scenarios) < wrong, 1 - true, true)
    forecast = generator.random((scenarios, samples)) < probability[:, None]
    observed = np.random.default_rng(8).random((scenarios, samples)) < true[:, None]
    return outcome_rows(
        {"reaches the target": forecast, COMPLEMENT: ~forecast, CERTAIN: np.ones_like(forecast)},
        {"reaches the target": observed, COMPLEMENT: ~observed, CERTAIN: np.ones_like(observed)},
        forecast[..., None],
        observed[..., None],
        np.ones_like(forecast),
    )
