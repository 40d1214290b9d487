"""How every network of the study is fitted: one Lightning Trainer, one way to stop, one log."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import torch
from lightning.pytorch.callbacks import Callback, EarlyStopping, ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger, Logger

from study.common.arrays import Doubles, Floats
from study.common.progress import Progress
from study.common.seeds import torch_seed
from study.metrics.mmd import mmd
from study.models import Model
from study.models.base import LOG_EVERY, ValidationScore
from study.training.data_module import TrajectoryDataModule

# Steps of the horizon that a look at the validation data scores, at most: those between them tell
# hardly more, since neighbouring steps fare alike.
SCORED_STEPS = 30


def validation_score(scale: Doubles, bandwidth: Doubles) -> ValidationScore:
    """Unbiased MMD² of forecasts [V, K, T, D] against observed [V, L, T, D], averaged.

    The same measure as on the test set, on scenarios of its own and at every few steps: what is
    tuned and stopped on is what is reported.
    """

    def score(forecasts: Floats, observed: Floats) -> float:
        horizon = forecasts.shape[2]
        every = -(-horizon // SCORED_STEPS)
        steps = slice((horizon - 1) % every, None, every)  # the last step, and back from it
        # Every scenario and step is compared by itself, so all may stand as steps of one scenario.
        x, y = (
            np.moveaxis(each[:, :, steps], 0, 1).reshape(1, each.shape[1], -1, each.shape[-1])
            for each in (forecasts, observed)
        )
        return float(mmd(x, y, scale, bandwidth).squared.mean())

    return score


class Told(Callback):
    """Tells the stage's progress."""

    def __init__(self, progress: Progress, steps: int) -> None:
        self.progress, self.steps = progress, steps

    def on_train_batch_end(self, trainer: L.Trainer, *_: Any) -> None:
        """One more step."""
        self.progress(trainer.global_step / self.steps, f"step {trainer.global_step}")


def fit(
    model: Model,
    data: TrajectoryDataModule,
    out: Path,
    progress: Progress,
    *,
    seed: int,
    steps: int,
    validate_every: int,
    patience: int | None,
    clip: float | None = 1.0,
    accelerator: str = "auto",
    loggers: Sequence[Logger] = (),
    callbacks: Sequence[Callback] = (),
) -> float:
    """Fit `model` and leave it with the weights of its best validation score, which is returned.

    ``metrics.csv`` in `out` holds the curves. With `patience` None training runs to its end and the
    last weights are kept.
    """
    L.seed_everything(torch_seed(seed), verbose=False)
    kept = out / "checkpoint"
    shutil.rmtree(kept, ignore_errors=True)
    best = ModelCheckpoint(kept, monitor="validation_score", save_weights_only=True)
    stop = EarlyStopping("validation_score", patience=patience or steps, check_finite=True)
    curves = CSVLogger(out, name="", version="", flush_logs_every_n_steps=10**9)
    trainer = L.Trainer(
        accelerator=accelerator,
        devices=1,
        max_steps=steps,
        val_check_interval=min(validate_every, steps),
        check_val_every_n_epoch=None,
        num_sanity_val_steps=0,
        gradient_clip_val=clip,
        log_every_n_steps=LOG_EVERY,
        logger=[curves, *loggers],
        callbacks=[stop, Told(progress, steps), *callbacks, *([best] if patience else [])],
        enable_checkpointing=patience is not None,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    trainer.fit(model, data)
    if patience and best.best_model_path:
        model.load_state_dict(torch.load(best.best_model_path, map_location="cpu")["state_dict"])
    shutil.rmtree(kept, ignore_errors=True)
    (out / "hparams.yaml").unlink(missing_ok=True)
    model.eval()
    score = best.best_model_score if patience else trainer.callback_metrics["validation_score"]
    return float(np.nan) if score is None else float(score)
