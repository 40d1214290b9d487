"""Stage record: the Rerun recordings of a cell, from the files of earlier stages.

Writes ``forecast.rrd`` and ``scores.rrd``, ``training.rrd`` for a fitted model, and ``tuning.rrd``
for a tuned model, each with its SHA-256.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import pandas as pd

from study.common.progress import Progress
from study.common.provenance import made_with, settings_of
from study.config.grid import Cell
from study.config.stage_settings import RecordSettings
from study.data.trajectories import ScenarioSet
from study.envs import Simulator
from study.envs.observe import system_of
from study.recording.examples import read_examples
from study.recording.forecast import record_forecast
from study.recording.properties import Properties
from study.recording.scores import record_scores
from study.recording.training import read_curves, record_training
from study.recording.tuning import read_trials, record_tuning


def run(
    settings: RecordSettings, inputs: Mapping[str, Path], out: Path, progress: Progress
) -> None:
    """Run the stage."""
    cell = Cell(settings.environment, settings.level, settings.model, settings.seed)
    properties = _properties(cell, inputs)
    # A residual model has both inputs. The recording shows the training of the residual model.
    fitted = inputs.get("trained", inputs.get("ensemble"))
    if fitted is not None:
        record_training(out / "training.rrd", read_curves(fitted / "metrics.csv"), properties)
    if "tuning" in inputs:
        trials = read_trials(inputs["tuning"] / "tuning.json")
        record_tuning(out / "tuning.rrd", trials, properties)
    progress(0.2, "scores")
    scores = pd.read_parquet(inputs["evaluation"] / "scores.parquet")
    record_scores(out / "scores.rrd", scores, properties)
    progress(0.5, "forecasts")
    simulator = _system(settings, inputs)
    examples = read_examples(inputs["evaluation"] / "examples.safetensors", scores, simulator)
    record_forecast(out / "forecast.rrd", simulator, examples, properties)


def _system(settings: RecordSettings, inputs: Mapping[str, Path]) -> Simulator:
    """The real system; the data set has the control step of a recorded one."""
    if settings.recorded is None:
        return system_of(settings.environment)
    facts = ScenarioSet.load(inputs["data"] / "validation.safetensors").facts
    step = facts["control_step"]
    return system_of(settings.environment, settings.recorded, control_step=step)


def _properties(cell: Cell, inputs: Mapping[str, Path]) -> Properties:
    """The cell, versions and source, and the settings of every stage before this one."""
    settings = {name: settings_of(folder) for name, folder in inputs.items()}
    config = json.dumps(settings, sort_keys=True)
    return {"cell": cell.name, **asdict(cell), **made_with(), "config": config}
