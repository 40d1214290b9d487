"""Fit any network of the study: a Lightning Trainer with early stopping and a CSV log."""

import shutil
import signal
from collections.abc import Generator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import torch
from lightning.fabric.plugins.environments.lightning import LightningEnvironment
from lightning.pytorch.callbacks import Callback, EarlyStopping, ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger
from lightning.pytorch.plugins import MixedPrecision, Precision

from study.common.progress import Progress
from study.common.seeds import torch_seed
from study.config.settings import Train
from study.models import Model
from study.models.base import LOG_EVERY
from study.models.runtime import report_use
from study.training.data_module import TrajectoryDataModule
from study.training.hardware import fit_device, fit_precision


@dataclass(frozen=True)
class FitOptions:
    """The options of a fit.

    Attributes:
        seed: of sampling during training.
        steps: largest number of optimiser steps.
        validate_every: steps between two evaluations on the validation data.
        patience: evaluations without improvement after which training stops; the model gets the
            best weights. None trains to the end; the model keeps the last weights.
        clip: largest norm of the gradient; None for no clipping.
        accelerator, precision: see `Train`.
    """

    seed: int
    steps: int
    validate_every: int
    patience: int | None
    clip: float | None = 1.0
    accelerator: str = "auto"
    precision: str = "32"

    @classmethod
    def from_settings(cls, train: Train, seed: int) -> "FitOptions":
        """The options of the section `train`."""
        return cls(
            seed,
            train.steps,
            train.validate_every,
            train.patience,
            accelerator=train.accelerator,
            precision=train.precision,
        )


class Bfloat16(MixedPrecision):
    """Lightning's ``bf16-mixed`` in training steps alone, with clipping and a fused optimiser.

    Lightning forbids these two together, since a fused optimiser also divides gradients by the
    scale of float16. There is no such scale for bfloat16.
    """

    def __init__(self, device: torch.device) -> None:
        super().__init__("bf16-mixed", device.type)

    def clip_gradients(self, *arguments: Any, **named: Any) -> None:
        """Clip as without mixed precision."""
        Precision.clip_gradients(self, *arguments, **named)

    @contextmanager
    def val_step_context(self) -> Generator[None, None, None]:
        """Validate in float32, as forecasts are made."""
        yield


@contextmanager
def _interruptible() -> Generator[None, None, None]:
    """Leave Ctrl-C to `study.run`. Lightning would end the process with exit code 1.

    Raises:
        KeyboardInterrupt: Lightning has stopped the fit because of Ctrl-C.
    """
    handler = signal.getsignal(signal.SIGINT)
    try:
        yield
    except SystemExit as end:
        if not isinstance(end.__context__, KeyboardInterrupt):
            raise
        with suppress(ValueError):  # only the main thread may set a handler
            signal.signal(signal.SIGINT, handler)
        raise end.__context__ from None


class ReportProgress(Callback):
    """Reports the share of optimiser steps that are done."""

    def __init__(self, progress: Progress, steps: int) -> None:
        self.progress, self.steps = progress, steps

    def on_train_batch_end(self, trainer: L.Trainer, *_: Any) -> None:
        """Report after each step."""
        self.progress(trainer.global_step / self.steps, f"step {trainer.global_step}")


def fit(
    model: Model,
    data: TrajectoryDataModule,
    out: Path,
    progress: Progress,
    options: FitOptions,
    callbacks: Sequence[Callback] = (),
) -> float:
    """Fit `model`, and leave it with the weights that `FitOptions.patience` asks for.

    Args:
        model: a new model. A callback, or the model itself, logs ``validation_score``.
        data: training and validation batches.
        out: folder for ``metrics.csv``, the training curves.
        progress: called with the fraction done.
        options: of the fit.
        callbacks: of Lightning, called before the checkpoint is written.

    Returns:
        the validation score of the weights; NaN if there was no validation.
    """
    L.seed_everything(torch_seed(options.seed), verbose=False)
    model.on_training_data(data.training_states())
    device = fit_device(options.accelerator, model, data, options.steps)
    precision = fit_precision(options.precision, model, device)
    report_use(device, precision)
    checkpoints = out / "checkpoint"
    shutil.rmtree(checkpoints, ignore_errors=True)
    best = ModelCheckpoint(checkpoints, monitor="validation_score", save_weights_only=True)
    patience = options.patience or options.steps
    stop = EarlyStopping("validation_score", patience=patience, check_finite=True)
    # One process, independent of the environment variables of a cluster.
    environment = LightningEnvironment()
    environment.set_global_rank(0)
    trainer = L.Trainer(
        plugins=[environment, *([Bfloat16(device)] if precision == "bf16" else [])],
        accelerator=device.type,
        devices=1,
        max_steps=options.steps,
        val_check_interval=min(options.validate_every, options.steps),
        check_val_every_n_epoch=None,
        num_sanity_val_steps=0,
        gradient_clip_val=options.clip,
        log_every_n_steps=LOG_EVERY,
        logger=CSVLogger(out, name="", version="", flush_logs_every_n_steps=10**9),
        callbacks=[
            stop,
            ReportProgress(progress, options.steps),
            *callbacks,
            *([best] if options.patience else []),
        ],
        enable_checkpointing=options.patience is not None,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    with _interruptible():
        trainer.fit(model, data)
    if options.patience and best.best_model_path:
        model.load_state_dict(torch.load(best.best_model_path, map_location="cpu")["state_dict"])
    shutil.rmtree(checkpoints, ignore_errors=True)
    (out / "hparams.yaml").unlink(missing_ok=True)
    model.eval()
    logged = trainer.callback_metrics
    score = best.best_model_score if options.patience else logged["validation_score"]
    return float(np.nan) if score is None else float(score)
