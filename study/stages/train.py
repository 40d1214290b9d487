"""Stage train: fit one cell's model, with the tuned β where it has one.

Writes ``model.safetensors``, ``metrics.csv``, ``training.rrd`` and ``fit.json`` (β, best score).
"""

import json
from pathlib import Path
from typing import Any

import torch

from study.common.files import read_json, write_json
from study.common.progress import Progress
from study.common.provenance import made_with
from study.common.seeds import derive, torch_seed
from study.models import Model, models
from study.models.checkpoints import build, save_model
from study.recording.training import RerunLogger
from study.stages.collect import read_kernel
from study.stages.ensemble import load_ensemble, load_members, training_data
from study.training.data_module import TrajectoryModule
from study.training.fit import fit, validation_score


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


def prepare(
    settings: dict[str, Any],
    inputs: dict[str, Path],
    beta: float | None,
    validation: int | None = None,
) -> tuple[Model, TrajectoryModule]:
    """A new model and its data, `validation` scenarios (all if None) among them."""
    training, scenarios, scaling = training_data(settings, inputs["data"])
    ensemble = members = None
    if models[settings["model"]].uses_ensemble:
        ensemble, members = load_ensemble(inputs["ensemble"]), load_members(inputs["ensemble"])
    torch.manual_seed(torch_seed(settings["seed"]))
    model = build(settings["model"], scaling, settings["sections"], beta, ensemble)
    _, scale, bandwidth = read_kernel(inputs["data"])
    model.validation_score = validation_score(scale, bandwidth)
    model.validation_seed = derive(settings["seed"], "validation")
    data = TrajectoryModule(
        scaling,
        training,
        scenarios[:validation],
        settings["sections"]["train"]["batch_size"],
        derive(settings["seed"], "order"),
        orders=model.orders,
        members=members,
    )
    return model, data
