"""``training.rrd`` holds what was logged, and is read from the file that Lightning wrote."""

from pathlib import Path
from typing import Any

import pytest
import torch
from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.loggers import CSVLogger
from torch.utils.data import DataLoader, TensorDataset

from study.recording.integrity import check
from study.recording.training import read_curves, record_training
from tests.helpers import reading, recordings


class Line(LightningModule):
    """A line through points that collects the losses that it logs."""

    def __init__(self) -> None:
        super().__init__()
        self.layer = torch.nn.Linear(1, 1)
        self.losses: list[float] = []

    def training_step(self, batch: list[torch.Tensor], index: int) -> torch.Tensor:
        loss = (self.layer(batch[0]) - batch[0]).square().mean()
        self.losses.append(float(loss.detach()))
        self.log("loss/nll", loss)
        return loss

    def validation_step(self, batch: list[torch.Tensor], index: int) -> None:
        self.log("validation_score", (self.layer(batch[0]) - batch[0]).abs().mean())

    def configure_optimizers(self) -> Any:
        return torch.optim.SGD(self.parameters(), lr=0.1)


def test_the_curves_of_a_fit(tmp_path: Path) -> None:
    model = Line()
    data = DataLoader(TensorDataset(torch.linspace(0, 1, 12)[:, None]), batch_size=4)
    Trainer(
        max_epochs=3,
        accelerator="cpu",
        logger=CSVLogger(tmp_path, name="", version=""),
        log_every_n_steps=1,
        default_root_dir=tmp_path,
        enable_progress_bar=False,
        enable_model_summary=False,
        enable_checkpointing=False,
    ).fit(model, data, data)
    path = tmp_path / "training.rrd"
    record_training(path, read_curves(tmp_path / "metrics.csv"), recordings.PROPERTIES)
    check(path)
    assert {"/loss/nll", "/validation_score", "/readme"} <= set(reading.entities(path))
    assert not any("epoch" in entity for entity in reading.entities(path))
    loss = reading.scalars(path, "/loss/nll")
    assert loss.index.tolist() == list(range(9))
    assert loss["value"].tolist() == pytest.approx(model.losses)
    assert len(reading.scalars(path, "/validation_score")) == 3
    assert reading.properties(path) == recordings.PROPERTIES


def test_a_fit_that_logged_nothing(tmp_path: Path) -> None:
    record_training(tmp_path / "training.rrd", {}, recordings.PROPERTIES)
    check(tmp_path / "training.rrd")
    assert reading.entities(tmp_path / "training.rrd") == ["/readme"]
