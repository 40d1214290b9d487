"""The inputs of a fit: the cell's training data, its ensemble, and a new model."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from study.common.arrays import Floats
from study.common.seeds import derive, torch_seed
from study.config.convert import from_json
from study.config.settings import Train
from study.config.stage_settings import TrainingSet, TrainSettings
from study.data.kernel import Kernel
from study.data.normalization import Normalization
from study.data.storage import load_arrays
from study.data.trajectories import ScenarioSet, Trajectories
from study.models import Model, models
from study.models.checkpoints import build, fitted_ensemble, load_model
from study.models.rnn_ensemble import RnnEnsemble
from study.models.sampling import repeat_samples
from study.training.augmentation import Augmentation
from study.training.data_module import TrajectoryDataModule
from study.training.validation import ForecastScore

VALIDATION_SAMPLES = 16
"""Forecasts of each validation scenario during training."""

VALIDATION_ROLLOUTS = 2
"""Most observed rollouts of a validation scenario in `validation_trajectories`."""


@dataclass(frozen=True)
class FitInputs:
    """A new model, its data and its training options.

    Attributes:
        model: with initial weights.
        data: batches for the model.
        train: the training options.
        score: the validation score.
    """

    model: Model
    data: TrajectoryDataModule
    train: Train
    score: ForecastScore


def prepare(
    settings: TrainSettings,
    inputs: Mapping[str, Path],
    beta: float | None,
    samples: int = VALIDATION_SAMPLES,
    scenarios: int | None = None,
) -> FitInputs:
    """Build a new model and its data.

    Args:
        settings: of the fit.
        inputs: folders ``data`` and, for a model that uses the ensemble, ``ensemble``.
        beta: β of equation (12); None for a model without one.
        samples: number of forecasts of each validation scenario.
        scenarios: number of validation scenarios; None takes all.

    Raises:
        StudyError: a file of `inputs` is missing or damaged.
    """
    model_class = models[settings.model]
    model_settings = from_json(model_class.settings_class, settings.model_settings)
    data_set = training_data(
        settings.training, inputs["data"], model_settings.train.symmetries, settings.seed
    )
    ensemble = members = None
    if model_class.uses_ensemble:
        ensemble, members = load_ensemble(inputs["ensemble"]), load_members(inputs["ensemble"])
    torch.manual_seed(torch_seed(settings.seed))
    model = build(settings.model, data_set.normalization, model_settings, beta, ensemble)
    data = TrajectoryDataModule(
        data_set.normalization,
        data_set.training,
        data_set.validation[:scenarios],
        model_settings.train.batch_size,
        derive(settings.seed, "order"),
        data_streams=model.data_streams,
        members=members,
        augmentation=data_set.augmentation,
    )
    kernel, seed = Kernel.load(inputs["data"]), derive(settings.seed, "validation")
    return FitInputs(model, data, model_settings.train, ForecastScore(kernel, samples, seed))


@dataclass(frozen=True)
class TrainingData:
    """The data of a fit.

    Attributes:
        training: the selected training trajectories.
        validation: the validation scenarios.
        normalization: the units; with symmetries, those of the transformed trajectories.
        augmentation: the symmetries of the training trajectories; None if none are applied.
    """

    training: Trajectories
    validation: ScenarioSet
    normalization: Normalization
    augmentation: Augmentation | None


def validation_trajectories(model: Model, data: TrajectoryDataModule) -> dict[str, Tensor]:
    """Observed trajectories of the validation scenarios, as a training batch of `model`.

    Args:
        model: has the units and, if it needs one, the fitted ensemble.
        data: its batches.

    Returns:
        The entries of a training batch, normalized: ``states`` [B, T+1, D], ``actions`` [B, T, A]
        and with an ensemble ``members`` [B, M, T, D]. Each scenario has at most
        `VALIDATION_ROLLOUTS` of the B trajectories.
    """
    scenarios = data.validation.tensors
    s0, actions = model.normalize(scenarios["s0"], scenarios["actions"])
    observed = model.normalize_states(scenarios["observed"][:, :VALIDATION_ROLLOUTS])
    rollouts = observed.shape[1]
    start = s0[:, None, None].expand(-1, rollouts, 1, -1)
    batch = {
        "states": torch.cat([start, observed], dim=2).flatten(0, 1),
        "actions": repeat_samples(actions, rollouts),
    }
    ensemble = fitted_ensemble(model)
    if ensemble is not None:
        with torch.no_grad():
            batch["members"] = repeat_samples(ensemble(s0, actions), rollouts)
    return batch


def training_data(
    selection: TrainingSet, folder: Path, symmetries: str = "none", seed: int = 0
) -> TrainingData:
    """The training data in a folder of the stage collect.

    Args:
        selection: a range of the training trajectories.
        folder: of the stage collect.
        symmetries: see `Train.symmetries`.
        seed: of the fit.

    Raises:
        StudyError: a file is missing or damaged.
    """
    training = training_trajectories(selection, folder)
    validation = ScenarioSet.load(folder / "validation.safetensors")
    augmentation = Augmentation.of(symmetries, training.facts, seed)
    group = None if augmentation is None else augmentation.group
    normalization = Normalization.from_trajectories(training, group)
    return TrainingData(training, validation, normalization, augmentation)


def training_trajectories(selection: TrainingSet, folder: Path) -> Trajectories:
    """The selected training trajectories in a folder of the stage collect.

    Raises:
        StudyError: the file is missing or damaged.
    """
    trajectories = Trajectories.load(folder / "train.safetensors")
    split = trajectories.facts.get("split", {"train": {}})
    return trajectories[selection.rows(list(split["train"].values()))]


def load_ensemble(folder: Path) -> RnnEnsemble:
    """The fitted ensemble in the folder of the stage ensemble.

    Raises:
        StudyError: the file is missing or damaged.
    """
    model = load_model(folder / "ensemble.safetensors")
    assert isinstance(model, RnnEnsemble)
    return model


def load_members(folder: Path) -> Floats:
    """The members' forecasts [N, M, T, D] of the training trajectories, in SI units.

    Args:
        folder: of the stage ensemble.

    Raises:
        StudyError: the file is missing or damaged.
    """
    arrays, _ = load_arrays(folder / "members.safetensors")
    return arrays["members"]
