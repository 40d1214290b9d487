"""Stage validate: score a fitted model on validation scenarios, for choices between models.

Writes ``validation.json``. Choices made here do not see the test set.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from study.common.files import read_json, write_json
from study.common.progress import Progress
from study.common.seeds import spawn
from study.config.stage_settings import ValidateSettings
from study.data.kernel import Kernel
from study.data.trajectories import ScenarioSet
from study.envs import simulators
from study.metrics.brier import brier_fair, climatology, skill
from study.metrics.variance import variance_ratio
from study.models.checkpoints import load_model
from study.models.forecasting import forecast_in_parts
from study.training.validation import validation_mmd2

FIRST_STEP = 10
"""Variances are compared from this step on: before it, trajectories have hardly spread."""


def run(
    settings: ValidateSettings, inputs: Mapping[str, Path], out: Path, progress: Progress
) -> None:
    """See the module."""
    validation = ScenarioSet.load(inputs["data"] / "validation.safetensors")
    observed = validation.observed
    simulator = simulators[settings.environment](horizon=validation.actions.shape[1])
    model = load_model(inputs["trained"] / "model.safetensors")
    kernel = Kernel.load(inputs["data"])
    seeds = spawn(settings.seed, len(validation))
    forecasts = forecast_in_parts(model, validation, settings.samples, seeds, progress)
    success = simulator.outcome(observed, validation.goal[:, None])
    forecast_success = simulator.outcome(forecasts, validation.goal[:, None])
    # The oracle forecasts each scenario's own probability: its score is the outcome's variance.
    oracle = success.var(axis=1, ddof=1, dtype=np.float64).mean()
    reference = climatology(success).mean()
    fair = brier_fair(forecast_success, success).mean()
    brier_skill = skill(float(fair), float(oracle), float(reference))
    first = min(FIRST_STEP, forecasts.shape[2] - 1)
    ratio = variance_ratio(forecasts, observed, kernel.scale)[first:]
    write_json(
        out / "validation.json",
        {
            "beta": read_json(inputs["trained"] / "fit.json")["beta"],
            "mmd2": validation_mmd2(forecasts, observed, kernel),
            # Undefined where the outcome of every scenario is certain.
            "brier_skill": brier_skill if np.isfinite(brier_skill) else None,
            # The median, since a single dimension may be far off.
            "variance_ratio": float(np.nanmedian(ratio)),
        },
    )
