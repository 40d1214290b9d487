"""Stage record: the cell's Rerun recordings, from what the earlier stages left.

Writes ``forecast.rrd`` and ``scores.rrd``, and where the cell has them ``training.rrd`` and
``tuning.rrd``, each with its SHA-256.
"""

import json
from pathlib import Path
from typing import Any

import pandas as pd

from study.common.files import copy, read_json
from study.common.progress import Progress
from study.common.provenance import made_with
from study.config.grid import Cell
from study.envs import simulators
from study.recording.examples import read_examples
from study.recording.forecasts import record_forecast
from study.recording.integrity import checksum_path
from study.recording.properties import Properties
from study.recording.scores import record_scores
from study.recording.tuning import record_tuning
from study.workflow.store import MANIFEST


def run(settings: dict[str, Any], inputs: dict[str, Path], out: Path, progress: Progress) -> None:
    """See the module."""
    cell = Cell(*(settings[name] for name in ("environment", "level", "model", "seed")))
    properties = _properties(cell, inputs)
    for source in ("trained", "ensemble"):
        if source in inputs:
            recording = inputs[source] / "training.rrd"
            copy(recording, out / recording.name)
            copy(checksum_path(recording), checksum_path(out / recording.name))
            break
    if "tuning" in inputs:
        tuning = read_json(inputs["tuning"] / "tuning.json")
        record_tuning(out / "tuning.rrd", _trials(tuning["trials"]), properties)
    progress(0.2, "scores")
    scores = pd.read_parquet(inputs["evaluation"] / "scores.parquet")
    record_scores(out / "scores.rrd", scores, properties)
    progress(0.5, "forecasts")
    simulator = simulators[cell.environment]()
    examples = read_examples(inputs["evaluation"] / "examples.safetensors", scores, simulator)
    record_forecast(out / "forecast.rrd", simulator, examples, properties)


def _properties(cell: Cell, inputs: dict[str, Path]) -> Properties:
    """What the recordings say of where they come from."""
    settings = {name: read_json(folder / MANIFEST)["settings"] for name, folder in inputs.items()}
    return {
        "cell": cell.name,
        "environment": cell.environment,
        "level": cell.level,
        "model": cell.model,
        "seed": cell.seed,
        **made_with(),
        "config": json.dumps(settings, sort_keys=True),
    }


def _trials(trials: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """JSON has no integer keys."""
    return [
        trial | {"intermediate": {int(k): v for k, v in trial["intermediate"].items()}}
        for trial in trials
    ]
