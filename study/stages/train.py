"""Stage train: fit one cell's model, with the tuned β where it has one.

Writes ``model.safetensors``, ``metrics.csv``, ``training.rrd`` and ``fit.json`` (β, best score).
"""

import json
from pathlib import Path
from typing import Any

from study.common.files import read_json, write_json
from study.common.progress import Progress
from study.common.provenance import made_with
from study.models.checkpoints import save_model
from study.recording.training import RerunLogger
from study.training.fit import fit
from study.training.inputs import prepare


def run(settings: dict[str, Any], inputs: dict[str, Path], out: Path, progress: Progress) -> None:
    """See the module."""
    beta = None
    if "tuning" in inputs:
        beta = read_json(inputs["tuning"] / "tuning.json")["beta"]
    model, data = prepare(settings, inputs, beta)
    train = settings["sections"]["train"]
    properties = {
        "seed": str(settings["seed"]),
        **made_with(),
        "config": json.dumps(settings, sort_keys=True),
    }
    with RerunLogger(
        out / "training.rrd", recording_name="training", properties=properties
    ) as logger:
        score = fit(
            model,
            data,
            out,
            progress,
            seed=settings["seed"],
            steps=train["steps"],
            validate_every=train["validate_every"],
            patience=train["patience"],
            accelerator=train["accelerator"],
            loggers=[logger],
        )
    save_model(model, settings["model"], out / "model.safetensors", beta)
    write_json(out / "fit.json", {"beta": beta, "validation_score": score})
