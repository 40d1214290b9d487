"""Stage validate: score a fitted model on validation scenarios, for choices between models.

Writes ``validation.json``. The test set is not looked at: what is chosen here may be tested there.
"""

from pathlib import Path
from typing import Any

import numpy as np

from study.common.files import read_json, write_json
from study.common.progress import Progress
from study.common.seeds import spawn
from study.data.kernel import Kernel
from study.data.trajectories import ScenarioSet
from study.envs import simulators
from study.metrics.brier import brier_fair, climatology, skill
from study.metrics.variance import variance_ratio
from study.models.checkpoints import load_model
from study.models.forecasting import forecast_in_parts
from study.training.fit import validation_score

FIRST_STEP = 10
"""Variances are compared from here on: before, hardly anything has varied."""


def run(settings: dict[str, Any], inputs: dict[str, Path], out: Path, progress: Progress) -> None:
    """See the module."""
    validation = ScenarioSet.load(inputs["data"] / "validation.safetensors")
    observed = validation.observed
    simulator = simulators[settings["environment"]](horizon=validation.actions.shape[1])
    model = load_model(inputs["trained"] / "model.safetensors")
    kernel = Kernel.load(inputs["data"])
    seeds = spawn(settings["seed"], len(validation))
    forecasts = forecast_in_parts(model, validation, settings["samples"], seeds, progress)
    success = simulator.outcome(observed, validation.goal[:, None])
    forecast_success = simulator.outcome(forecasts, validation.goal[:, None])
    # The oracle knows each scenario's own rate of success: what is left is the outcome's variance.
    oracle = success.var(axis=1, ddof=1, dtype=np.float64).mean()
    reference = climatology(success).mean()
    fair = brier_fair(forecast_success, success).mean()
    gained = skill(float(fair), float(oracle), float(reference))
    ratio = variance_ratio(forecasts, observed, kernel.scale)[
        min(FIRST_STEP, len(forecasts[0, 0]) - 1) :
    ]
    write_json(
        out / "validation.json",
        {
            "beta": read_json(inputs["trained"] / "fit.json")["beta"],
            "mmd2": validation_score(kernel.scale, kernel.bandwidth)(forecasts, observed),
            "brier_skill": gained if np.isfinite(gained) else None,  # nothing to know: no skill
            # Of dimensions one may be forecast far too widely: the median says what is usual.
            "variance_ratio": float(np.nanmedian(ratio)),
        },
    )
