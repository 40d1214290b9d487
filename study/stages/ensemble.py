"""Stage ensemble: fit the M recurrent networks, and forecast the training trajectories with them.

Writes ``ensemble.safetensors`` (weights), ``members.safetensors`` (the members' forecasts of the
training trajectories, [N, M, T, D]: the residuals of every cell are made from them),
``metrics.csv`` and ``training.rrd``.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch

from study.common.arrays import Floats
from study.common.progress import Progress
from study.common.provenance import made_with
from study.common.seeds import derive, torch_seed
from study.data.storage import save_parts
from study.models.checkpoints import save_model
from study.models.forecasting import members_in_parts
from study.models.rnn_ensemble import Ensemble
from study.recording.training import RerunLogger
from study.training.data_module import TrajectoryDataModule
from study.training.fit import fit
from study.training.inputs import training_data

CHUNK = 512


def run(settings: dict[str, Any], inputs: dict[str, Path], out: Path, progress: Progress) -> None:
    """See the module."""
    training, validation, normalization = training_data(settings, inputs["data"])
    options = settings["ensemble"]
    folds = options["cross_fit"]
    data = TrajectoryDataModule(
        normalization,
        training,
        validation,
        options["batch_size"],
        derive(settings["seed"], "order"),
        orders=options["members"],
        folds=folds,
    )
    torch.manual_seed(torch_seed(settings["seed"]))
    model = Ensemble(normalization, {"ensemble": options})
    properties = {
        "seed": str(settings["seed"]),
        **made_with(),
        "config": json.dumps(settings, sort_keys=True),
    }
    with RerunLogger(
        out / "training.rrd", recording_name="training of the ensemble", properties=properties
    ) as logger:
        fit(
            model,
            data,
            out,
            progress.part(0.0, 0.95),
            seed=settings["seed"],
            steps=options["steps"],
            validate_every=options["validate_every"],
            patience=options["patience"],
            clip=None,
            loggers=[logger],
        )
    save_model(model, "ensemble", out / "ensemble.safetensors")
    progress(0.95, "forecasts of the training trajectories")
    parts = members_in_parts(model, training.states[:, 0], training.actions)
    if folds:
        parts = that_left_it_out(parts)
    save_parts(out / "members.safetensors", ({"members": part} for part in parts), len(training))


def that_left_it_out(parts: Iterator[Floats]) -> Iterator[Floats]:
    """ŷ_m [n, M, T, D] of trajectories in a row: of each that member's for all which left it out.

    See `ShuffledBatches`. So whatever member a residual model draws, it has never seen the
    trajectory.
    """
    first = 0
    for part in parts:
        rows, members = np.arange(len(part)), part.shape[1]
        chosen = part[rows, (first + rows) % members]
        yield np.broadcast_to(chosen[:, None], part.shape)
        first += len(part)
