"""Stage evaluate: forecast the test scenarios, and score the forecasts.

Every forecaster, the oracle included, is scored by the same code. Writes

- ``scores.parquet``, the tidy table of `study.metrics.tables.scores`;
- ``examples.safetensors``, for the recordings: the forecasts of a few scenarios, which the rules of
  `study.recording.examples` select;
- ``illustration.safetensors`` for a forecaster with an ensemble: the positions and variances that
  Fig. 1 of the paper shows.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from study.common.progress import Progress
from study.common.seeds import spawn
from study.config.stage_settings import EvaluateSettings
from study.data.kernel import Kernel
from study.data.storage import save_arrays
from study.data.trajectories import ScenarioSet
from study.envs.observe import system_of
from study.metrics.device import scores_on
from study.metrics.tables.scores import Outcomes, score
from study.metrics.tables.trajectory_scores import log_score_rows
from study.models.forecasting import (
    example_arrays,
    forecast_in_parts,
    load_forecaster,
    members_of_samples,
)
from study.models.log_score import log_scores
from study.models.oracle import Oracle
from study.models.references import reference
from study.recording.examples import choose_examples
from study.recording.illustration import illustrate
from study.training.hardware import forecast_on_faster_device
from study.training.inputs import training_trajectories


def run(
    settings: EvaluateSettings, inputs: Mapping[str, Path], out: Path, progress: Progress
) -> None:
    """Run the stage."""
    evaluate = settings.evaluate
    test = ScenarioSet.load(inputs["data"] / "test.safetensors")
    simulator = system_of(
        settings.environment, settings.recorded, test.actions.shape[1], test.facts["control_step"]
    )
    if settings.training is not None:
        training = training_trajectories(settings.training, inputs["data"])
        validation = ScenarioSet.load(inputs["data"] / "validation.safetensors")
        forecaster = reference(settings.model, training, validation)
    else:
        forecaster = load_forecaster(settings.model, simulator, inputs)
    kernel = Kernel.load(inputs["data"])
    seeds = spawn(settings.seed, len(test))
    device = forecast_on_faster_device(settings.accelerator, forecaster, test, seeds)
    progress(0.01, "forecasting")
    part = progress.part(0.01, 0.5)
    forecasts = forecast_in_parts(forecaster, test, evaluate.samples, seeds, part)
    goal = test.goal[:, None]
    scoring = progress.part(0.5, 1.0)
    with scores_on(device):
        scores = score(
            forecasts,
            test.observed,
            Outcomes(
                simulator.outcomes(forecasts, goal),
                simulator.outcomes(test.observed, goal),
                simulator.reached(forecasts, goal),
                simulator.reached(test.observed, goal),
            ),
            kernel.scale,
            kernel.bandwidth * evaluate.bandwidth,
            kernel.names,
            members_of_samples(forecaster, seeds, evaluate.samples),
            reference_shifts=isinstance(forecaster, Oracle),
            progress=lambda share: scoring(share, "scoring"),
        )
    if settings.recorded is not None:
        log = log_scores(forecaster, test)
        scores = scores if log is None else pd.concat([scores, log_score_rows(log)])
    scores.to_parquet(out / "scores.parquet", index=False)
    examples = choose_examples(scores, evaluate.examples)
    arrays = example_arrays(forecaster, test, forecasts, seeds, np.array(list(examples.values())))
    save_arrays(out / "examples.safetensors", arrays, {"rules": list(examples)})
    if "members" in arrays and simulator.has_position:
        illustration, facts = illustrate(simulator, arrays, list(examples))
        save_arrays(out / "illustration.safetensors", illustration, facts)
