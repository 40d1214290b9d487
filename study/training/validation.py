"""The validation score: MMD² of autoregressive forecasts, as on the test set."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import lightning as L
import numpy as np
from lightning.pytorch.callbacks import Callback
from torch import Tensor

from study.common.arrays import Floats
from study.common.seeds import spawn
from study.data.kernel import Kernel
from study.metrics.mmd import mmd
from study.models import Model

MOST_STEPS = 30
"""Largest number of steps that are scored, since neighbouring steps have similar scores."""


def validation_mmd2(forecasts: Floats, observed: Floats, kernel: Kernel) -> float:
    """Unbiased MMD² averaged over scenarios, dimensions and evenly spaced steps.

    The test set is scored by the same measure. So early stopping and the search for β minimise the
    reported score, on separate scenarios.

    Args:
        forecasts: [V, K, T, D] in SI units.
        observed: [V, L, T, D] in SI units.
        kernel: scales and bandwidths.
    """
    horizon = forecasts.shape[2]
    stride = -(-horizon // MOST_STEPS)
    steps = slice((horizon - 1) % stride, None, stride)  # ends with the last step
    # MMD² is computed for each scenario and step. So one call takes all of them as steps.
    x, y = (
        np.moveaxis(values[:, :, steps], 0, 1).reshape(1, values.shape[1], -1, values.shape[-1])
        for values in (forecasts, observed)
    )
    return float(mmd(x, y, kernel.scale, kernel.bandwidth).squared.mean())


@dataclass(frozen=True)
class ForecastScore:
    """Scores a model by its autoregressive forecasts of the validation scenarios.

    Attributes:
        kernel: scales and bandwidths.
        samples: K, the number of forecasts of each scenario.
        seed: of the forecasts, the same at every evaluation.
    """

    kernel: Kernel
    samples: int
    seed: int

    def __call__(self, model: Model, batch: Mapping[str, Tensor]) -> float:
        """The validation MMD² of `model` on a validation batch of `TrajectoryDataModule`."""
        s0, actions, observed = (
            batch[name].cpu().numpy() for name in ("s0", "actions", "observed")
        )
        forecasts = model.forecast(s0, actions, self.samples, spawn(self.seed, len(s0)))
        return validation_mmd2(forecasts, observed, self.kernel)


class LogNegativeElbo(Callback):
    """Logs `Model.negative_elbo` of observed trajectories as ``validation_score``.

    Args:
        batch: the trajectories, see `Model.diagnostics`.
    """

    def __init__(self, batch: Mapping[str, Tensor]) -> None:
        self.batch = batch

    def on_validation_batch_end(
        self, trainer: L.Trainer, model: L.LightningModule, *_: Any
    ) -> None:
        """Score the model on the trajectories."""
        assert isinstance(model, Model)
        batch = {name: values.to(model.device) for name, values in self.batch.items()}
        model.log("validation_score", model.negative_elbo(batch), batch_size=len(batch["states"]))


class LogForecastScore(Callback):
    """Logs a `ForecastScore` as ``validation_score`` at every validation."""

    def __init__(self, score: ForecastScore) -> None:
        self.score = score

    def on_validation_batch_end(
        self, trainer: L.Trainer, model: L.LightningModule, outputs: Any, batch: Any, *_: Any
    ) -> None:
        """Score the model on the one validation batch."""
        assert isinstance(model, Model)
        score = self.score(model, batch)
        model.log("validation_score", score, batch_size=len(batch["s0"]))
