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

from study.common.progress import Progress
from study.common.provenance import made_with
from study.common.seeds import derive, torch_seed
from study.data.normalization import Scaling
from study.data.storage import load_arrays, save_parts
from study.data.trajectories import Floats, ScenarioSet, Trajectories
from study.models.checkpoints import load_model, save_model
from study.models.model_ensemble import EnsembleOf
from study.models.rnn_ensemble import Ensemble
from study.recording.training import RerunLogger
from study.training.data_module import TrajectoryModule
from study.training.fit import fit

CHUNK = 512


def run(settings: dict[str, Any], inputs: dict[str, Path], out: Path, progress: Progress) -> None:
    """See the module."""
    training, validation, scaling = training_data(settings, inputs["data"])
    options = settings["ensemble"]
    folds = options.get("data") == "folds"
    data = TrajectoryModule(
        scaling,
        training,
        validation,
        options["batch_size"],
        derive(settings["seed"], "order"),
        orders=options["members"],
        folds=folds,
    )
    torch.manual_seed(torch_seed(settings["seed"]))
    model = Ensemble(scaling, {"ensemble": options})
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


def training_data(
    settings: dict[str, Any], folder: Path
) -> tuple[Trajectories, ScenarioSet, Scaling]:
    """The cell's share of the training trajectories, the validation scenarios, standard units."""
    first, count = settings["first"], settings["trajectories"]
    training = Trajectories.load(folder / "train.safetensors")[first : first + count]
    validation = ScenarioSet.load(folder / "validation.safetensors")
    return training, validation, Scaling.of(training)


def forecast_members(model: Ensemble | EnsembleOf, s0: Floats, actions: Floats) -> Floats:
    """ŷ_m of all members [N, M, T, D] in SI units, from [N, D] and [N, T, A] in SI units."""
    return np.concatenate(list(members_in_parts(model, s0, actions)))


@torch.no_grad()
def members_in_parts(model: Ensemble | EnsembleOf, s0: Floats, actions: Floats) -> Iterator[Floats]:
    """As `forecast_members`, some trajectories at a time."""
    for start in range(0, len(s0), CHUNK):
        chunk = slice(start, start + CHUNK)
        standard = model.standard(torch.from_numpy(s0[chunk]), torch.from_numpy(actions[chunk]))
        yield model.physical(model(*standard)).cpu().numpy()


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


def load_ensemble(folder: Path) -> Ensemble:
    """The fitted ensemble that `run` wrote."""
    model = load_model(folder / "ensemble.safetensors")
    assert isinstance(model, Ensemble)
    return model


def load_members(folder: Path) -> Floats:
    """The members' forecasts of the training trajectories [N, M, T, D] that `run` wrote."""
    arrays, _ = load_arrays(folder / "members.safetensors")
    return arrays["members"]
