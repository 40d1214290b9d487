"""What a fit starts from: the cell's training data, its ensemble, and a new model."""

from pathlib import Path
from typing import Any

import torch

from study.common.arrays import Floats
from study.common.seeds import derive, torch_seed
from study.data.kernel import Kernel
from study.data.normalization import Normalization
from study.data.storage import load_arrays
from study.data.trajectories import ScenarioSet, Trajectories
from study.models import Model, models
from study.models.checkpoints import build, load_model
from study.models.rnn_ensemble import Ensemble
from study.training.data_module import TrajectoryDataModule
from study.training.fit import validation_score


def training_data(
    settings: dict[str, Any], folder: Path
) -> tuple[Trajectories, ScenarioSet, Normalization]:
    """The cell's share of the training trajectories, the validation scenarios, standard units."""
    first, count = settings["first"], settings["trajectories"]
    training = Trajectories.load(folder / "train.safetensors")[first : first + count]
    validation = ScenarioSet.load(folder / "validation.safetensors")
    return training, validation, Normalization.of(training)


def prepare(
    settings: dict[str, Any],
    inputs: dict[str, Path],
    beta: float | None,
    validation: int | None = None,
) -> tuple[Model, TrajectoryDataModule]:
    """A new model and its data, `validation` scenarios (all if None) among them."""
    training, scenarios, normalization = training_data(settings, inputs["data"])
    ensemble = members = None
    if models[settings["model"]].uses_ensemble:
        ensemble, members = load_ensemble(inputs["ensemble"]), load_members(inputs["ensemble"])
    torch.manual_seed(torch_seed(settings["seed"]))
    model = build(settings["model"], normalization, settings["sections"], beta, ensemble)
    kernel = Kernel.load(inputs["data"])
    model.validation_score = validation_score(kernel.scale, kernel.bandwidth)
    model.validation_seed = derive(settings["seed"], "validation")
    data = TrajectoryDataModule(
        normalization,
        training,
        scenarios[:validation],
        settings["sections"]["train"]["batch_size"],
        derive(settings["seed"], "order"),
        orders=model.orders,
        members=members,
    )
    return model, data


def load_ensemble(folder: Path) -> Ensemble:
    """The fitted ensemble that `run` wrote."""
    model = load_model(folder / "ensemble.safetensors")
    assert isinstance(model, Ensemble)
    return model


def load_members(folder: Path) -> Floats:
    """The members' forecasts of the training trajectories [N, M, T, D] that `run` wrote."""
    arrays, _ = load_arrays(folder / "members.safetensors")
    return arrays["members"]
