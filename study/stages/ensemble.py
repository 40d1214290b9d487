"""Stage ensemble: fit the M recurrent networks, and forecast the training trajectories with them.

These are lines 1 and 5 of Algorithm 1: ŷ_m of every trajectory and member is computed once.

Writes ``ensemble.safetensors`` (weights), ``members.safetensors`` (the members' forecasts of the
training trajectories, [N, M, T, D], from which every cell's residuals are computed) and
``metrics.csv`` (training curves).
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import torch

from study.common.arrays import Floats
from study.common.progress import Progress
from study.common.seeds import derive, torch_seed
from study.config.stage_settings import EnsembleSettings
from study.data.storage import save_parts
from study.models.checkpoints import save_model
from study.models.forecasting import forecast_members_in_parts
from study.models.rnn_ensemble import RnnEnsemble, RnnEnsembleSettings
from study.training.data_module import TrajectoryDataModule
from study.training.fit import FitOptions, fit
from study.training.inputs import training_data


def run(
    settings: EnsembleSettings, inputs: Mapping[str, Path], out: Path, progress: Progress
) -> None:
    """Run the stage."""
    ensemble = settings.ensemble
    data_set = training_data(settings.training, inputs["data"], ensemble.symmetries, settings.seed)
    training = data_set.training
    data = TrajectoryDataModule(
        data_set.normalization,
        training,
        data_set.validation,
        ensemble.batch_size,
        derive(settings.seed, "order"),
        data_streams=ensemble.members,
        cross_fit=ensemble.cross_fit,
        augmentation=data_set.augmentation,
    )
    torch.manual_seed(torch_seed(settings.seed))
    model = RnnEnsemble(data_set.normalization, RnnEnsembleSettings(ensemble, settings.network))
    options = FitOptions(
        settings.seed,
        ensemble.steps,
        ensemble.validate_every,
        ensemble.patience,
        clip=None,
        accelerator=settings.accelerator,
        precision=settings.precision,
    )
    fit(model, data, out, progress.part(0.0, 0.95), options)
    save_model(model, "ensemble", out / "ensemble.safetensors")
    progress(0.95, "forecasts of the training trajectories")
    parts = forecast_members_in_parts(model, training.states[:, 0], training.actions)
    if ensemble.cross_fit:
        parts = _out_of_fold(parts)
    save_parts(out / "members.safetensors", ({"members": part} for part in parts), len(training))


def _out_of_fold(parts: Iterator[Floats]) -> Iterator[Floats]:
    """Replace every member's forecast by that of the member whose fold holds the trajectory.

    That member was not trained on the trajectory. So a residual model is trained on out-of-fold
    residuals alone, for every member that it samples. `ShuffledBatches` defines the folds.

    Args:
        parts: ŷ_m [n, M, T, D] of consecutive trajectories.
    """
    first = 0
    for part in parts:
        rows, members = np.arange(len(part)), part.shape[1]
        out_of_fold = part[rows, (first + rows) % members]
        yield np.broadcast_to(out_of_fold[:, None], part.shape)
        first += len(part)
