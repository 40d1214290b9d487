"""The evidence lower bound of validation trajectories, as a score of the search for β."""

from typing import Any

import lightning as L
from lightning.pytorch.callbacks import Callback

from study.models import Model
from study.training.data_module import TrajectoryDataModule
from study.training.inputs import validation_trajectories


class LogNegativeElbo(Callback):
    """Logs `Model.negative_elbo` of validation trajectories as ``validation_score``.

    Args:
        data: of the fit.
    """

    def __init__(self, data: TrajectoryDataModule) -> None:
        self.data = data

    def on_validation_batch_end(
        self, trainer: L.Trainer, model: L.LightningModule, *_: Any
    ) -> None:
        """Score the model on the validation trajectories."""
        assert isinstance(model, Model)
        batch = validation_trajectories(model, self.data)
        model.log("validation_score", model.negative_elbo(batch), batch_size=len(batch["states"]))
