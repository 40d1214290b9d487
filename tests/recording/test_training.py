"""``training.rrd``: the Lightning logger records what is logged, in any order of fits."""

import math
import pickle
from pathlib import Path
from typing import Any

import pytest
import torch
from lightning.pytorch import LightningModule, Trainer
from torch.utils.data import DataLoader, TensorDataset

from study.recording.integrity import check
from study.recording.training import RerunLogger
from tests.helpers import reading, recordings


class Line(LightningModule):
    """A line through points that collects the losses that it logs."""

    def __init__(self) -> None:
        super().__init__()
        self.layer = torch.nn.Linear(1, 1)
        self.losses: list[float] = []
        self.save_hyperparameters({"width": 1})

    def training_step(self, batch: list[torch.Tensor], index: int) -> torch.Tensor:
        loss = (self.layer(batch[0]) - batch[0]).square().mean()
        self.losses.append(float(loss.detach()))
        self.log("train/loss", loss)
        return loss

    def validation_step(self, batch: list[torch.Tensor], index: int) -> None:
        self.log("validation/loss", (self.layer(batch[0]) - batch[0]).abs().mean())

    def configure_optimizers(self) -> Any:
        return torch.optim.SGD(self.parameters(), lr=0.1)


def test_a_fit_a_validate_and_another_fit_share_a_recording(tmp_path: Path) -> None:
    path = tmp_path / "training.rrd"
    logger = RerunLogger(path, properties=recordings.PROPERTIES)
    model = Line()
    data = DataLoader(TensorDataset(torch.linspace(0, 1, 12)[:, None]), batch_size=4)
    options: dict[str, Any] = {
        "accelerator": "cpu", "logger": logger, "log_every_n_steps": 1,
        "default_root_dir": tmp_path,
        "enable_progress_bar": False, "enable_model_summary": False, "enable_checkpointing": False,
    }  # fmt: skip
    Trainer(max_epochs=2, **options).fit(model, data, data)
    Trainer(**options).validate(model, data, verbose=False)
    Trainer(max_epochs=1, **options).fit(model, data, data)
    assert not path.exists()
    logger.close()
    logger.close()
    check(path)
    recorded = reading.scalars(path, "/train/loss")["value"]
    assert sorted(recorded) == pytest.approx(sorted(model.losses))
    assert {"/hyperparameters", "/readme", "/validation/loss"} <= set(reading.entities(path))
    assert reading.properties(path) == recordings.PROPERTIES


def test_values_stay_in_order_and_nan_is_allowed(tmp_path: Path) -> None:
    with RerunLogger(tmp_path / "a.rrd", rows=3) as logger:
        for step in range(8):
            logger.log_metrics({"loss": math.nan if step == 4 else float(step)}, step)
            logger.finalize("success")
        logger.log_metrics({"loss": 8.0})
    frame = reading.scalars(tmp_path / "a.rrd", "/loss")
    assert frame.index.tolist() == list(range(9))
    assert frame["value"].isna().tolist() == [step == 4 for step in range(9)]
    with pytest.raises(ValueError, match="closed"):
        logger.log_metrics({"loss": 1.0}, 9)


def test_a_failure_leaves_nothing(tmp_path: Path) -> None:
    def fail() -> None:
        with RerunLogger(tmp_path / "a.rrd", rows=1) as logger:
            logger.log_metrics({"loss": 1.0}, 0)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_a_pickled_logger_has_logged_nothing(tmp_path: Path) -> None:
    logger = RerunLogger(tmp_path / "a.rrd", properties={"cell": "x"}, rows=1)
    logger.log_metrics({"loss": 1.0}, 0)
    copy = pickle.loads(pickle.dumps(logger))
    copy.log_metrics({"loss": 2.0}, 0)
    copy.close()
    assert reading.scalars(tmp_path / "a.rrd", "/loss")["value"].tolist() == [2.0]
    logger.close()
    assert reading.scalars(tmp_path / "a.rrd", "/loss")["value"].tolist() == [1.0]
