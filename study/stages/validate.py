"""Stage validate: score a fitted model on validation scenarios, for choices between models.

Writes ``validation.json``. A choice by these scores does not use the test set.
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
from study.envs.observe import system_of
from study.metrics.brier import brier_fair, brier_oracle, climatology, skill
from study.metrics.variance import median_ratio, variance_ratio
from study.models.checkpoints import load_model
from study.models.forecasting import forecast_in_parts
from study.training.hardware import forecast_on_faster_device
from study.training.validation import validation_mmd2


def run(
    settings: ValidateSettings, inputs: Mapping[str, Path], out: Path, progress: Progress
) -> None:
    """Run the stage."""
    validation = ScenarioSet.load(inputs["data"] / "validation.safetensors")
    observed = validation.observed
    simulator = system_of(settings.environment, settings.recorded, validation.actions.shape[1])
    model = load_model(inputs["trained"] / "model.safetensors")
    kernel = Kernel.load(inputs["data"])
    seeds = spawn(settings.seed, len(validation))
    forecast_on_faster_device(settings.accelerator, model, validation, seeds)
    forecasts = forecast_in_parts(model, validation, settings.samples, seeds, progress)
    once = observed.shape[1] == 1
    success = simulator.outcome(observed, validation.goal[:, None])
    forecast_success = simulator.outcome(forecasts, validation.goal[:, None])
    # The best score of outcomes that were observed once is not known: 1 is a perfect forecast.
    oracle = 0.0 if once else brier_oracle(success.mean(1), success.shape[1]).mean()
    reference = climatology(success).mean()
    finite = np.asarray(np.isfinite(forecasts).all((2, 3)))
    fair = brier_fair(forecast_success, success, finite).mean()
    brier_skill = skill(float(fair), float(oracle), float(reference))
    ratio = None if once else variance_ratio(forecasts, observed, kernel.scale)
    fit = read_json(inputs["trained"] / "fit.json")  # β, and posterior statistics of VAEs
    write_json(
        out / "validation.json",
        {
            **{name: fit[name] for name in fit if name != "validation_score"},
            "mmd2": validation_mmd2(forecasts, observed, kernel),
            # Undefined where the outcome of every scenario is certain.
            "brier_skill": brier_skill if np.isfinite(brier_skill) else None,
            "variance_ratio": None
            if ratio is None
            else median_ratio(ratio.T, np.arange(1, len(ratio) + 1)),
        },
    )
