"""Stage train: fit one cell's model, with the β of the stage tune if the cell has that stage.

Writes ``model.safetensors``, ``metrics.csv`` (training curves) and ``fit.json`` (β, the validation
score, and `Model.diagnostics` of the fitted model).
"""

from collections.abc import Mapping
from pathlib import Path

from study.common.files import read_json, write_json
from study.common.progress import Progress
from study.config.stage_settings import TrainSettings
from study.models.checkpoints import save_model
from study.training.fit import FitOptions, fit
from study.training.inputs import prepare, validation_trajectories
from study.training.validation import LogForecastScore


def run(settings: TrainSettings, inputs: Mapping[str, Path], out: Path, progress: Progress) -> None:
    """Run the stage."""
    beta = None
    if "tuning" in inputs:
        beta = read_json(inputs["tuning"] / "tuning.json")["beta"]
    start = prepare(settings, inputs, beta)
    options = FitOptions.from_settings(start.train, settings.seed)
    callbacks = [LogForecastScore(start.score)]
    score = fit(start.model, start.data, out, progress, options, callbacks)
    save_model(start.model, settings.model, out / "model.safetensors", beta)
    diagnostics = start.model.diagnostics(validation_trajectories(start.model, start.data))
    write_json(out / "fit.json", {"beta": beta, "validation_score": score, **diagnostics})
