"""What is measured on each device, with the CPU in the place of a GPU."""

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from study.common.seeds import spawn
from study.data.normalization import Normalization
from study.data.trajectories import ScenarioSet
from study.models.base import Model
from study.models.probabilistic_mlp import ProbabilisticMlp
from study.models.runtime import forget_uses, uses
from study.training import data_module, hardware
from study.training.augmentation import Augmentation, AugmentedTrajectories
from study.training.data_module import TrajectoryDataModule
from study.training.hardware import fit_device, forecast_on_faster_device
from tests.helpers.models import OURS, model, normalization, settings, trajectories

STEPS = 10


@pytest.fixture(autouse=True)
def second_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """The CPU in the place of a GPU, for one run."""
    monkeypatch.setattr(hardware, "gpu", lambda accelerator: torch.device("cpu", 0))
    monkeypatch.setattr(hardware, "TRIAL_SECONDS", 0.0)
    monkeypatch.setattr(hardware, "WARM_UPS", 1)


def scenarios() -> ScenarioSet:
    observed = trajectories(6, seed=3)
    return ScenarioSet(
        observed.states[:, 0],
        observed.actions,
        np.zeros((6, 1), np.float32),
        observed.states[:, None, 1:],
        np.zeros((6, 1, 0), np.float32),
        {},
    )


def data_of(network: Model) -> TrajectoryDataModule:
    members = np.zeros((12, 3, 6, 3), np.float32) if network.uses_ensemble else None
    return TrajectoryDataModule(
        normalization(), trajectories(), scenarios(), 4, 0, network.data_streams, members
    )


@pytest.mark.parametrize("name", ["ensemble", *OURS])
def test_every_model_is_measured(name: str, caplog: pytest.LogCaptureFixture) -> None:
    """A fit and a forecast run on both devices, and leave no trace."""
    network, test = model(name), scenarios()
    data = data_of(network)
    network.on_training_data(data.training_states())
    before = {key: value.clone() for key, value in network.state_dict().items()}
    state = torch.get_rng_state()
    forget_uses()
    with caplog.at_level(logging.INFO):
        assert fit_device("auto", network, data, STEPS).type == "cpu"
        assert forecast_on_faster_device("auto", network, test, spawn(0, len(test))) is None
    lines = [record.message for record in caplog.records]
    assert len(lines) == 2  # a failure would be a line more
    assert all(line.startswith("accelerator auto: cpu") for line in lines)
    assert uses() == "cpu"
    assert torch.equal(torch.get_rng_state(), state)
    assert all(p.grad is None for p in network.parameters())
    for key, value in network.state_dict().items():
        assert torch.equal(value, before[key])


def test_a_model_with_a_step_of_its_own(caplog: pytest.LogCaptureFixture) -> None:
    calls: list[Tensor] = []

    class Own(ProbabilisticMlp):
        losses = Model.losses

        def training_step(self, batch: dict[str, Tensor]) -> Tensor:
            calls.append(batch["states"])
            return ProbabilisticMlp.losses(self, batch, 0)["loss"]

    network = Own(normalization(), settings("probabilistic_mlp"))
    fit_device("auto", network, data_of(network), STEPS)
    assert calls
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING]


class Group:
    """Symmetries that sample one number a batch, and change nothing."""

    def sample(self, generator: np.random.Generator, states: Any) -> "Group":
        self.number = generator.normal()
        return self

    def states(self, values: Any) -> Any:
        return values + np.float32(self.number)

    def actions(self, values: Any) -> Any:
        return values


@pytest.mark.parametrize("augmented", [False, True])
def test_the_first_batch_has_no_effect_on_those_that_follow(augmented: bool) -> None:
    batches = []
    for is_measured in (False, True):
        group: Any = Group()
        data = TrajectoryDataModule(normalization(), trajectories(), scenarios(), 4, 0)
        if augmented:
            units: Normalization = normalization()
            data.training = AugmentedTrajectories(
                Augmentation(group, 0), units, trajectories(), None
            )
        first = data.first_batch() if is_measured else None
        loader = iter(data.train_dataloader())
        batches.append([next(loader)["states"] for _ in range(4)])
        assert first is None or torch.equal(first["states"], batches[-1][0])
    assert all(map(torch.equal, *batches))


@pytest.mark.parametrize(("free", "expected"), [(10**9, "meta"), (10, "cpu")])
def test_the_data_set_lies_on_the_device_if_it_fits(
    free: int, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[torch.device] = []

    def free_memory(device: torch.device) -> int:
        asked.append(device)
        return free

    monkeypatch.setattr(data_module, "free_memory", free_memory)
    data = TrajectoryDataModule(normalization(), trajectories(), scenarios(), 4, 0)
    trainer: Any = type("Trainer", (), {})()
    trainer.strategy = type("Strategy", (), {"root_device": torch.device("meta")})()
    data.trainer = trainer
    batch = next(iter(data.train_dataloader()))
    assert {values.device.type for values in batch.values()} == {expected}
    assert asked == [torch.device("meta")]
    assert data.training_states().device.type == "cpu"  # the module itself stays
