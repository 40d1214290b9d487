"""The training of the CRPS models: options, learning rate and optimizer."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from study.config.convert import to_json
from study.config.grid import Cell
from study.config.model_sections import Crps, Network
from study.config.settings import Config
from study.models.crps import EVALUATIONS, CrpsModel, CrpsSettings, two_cycles
from study.workflow.pipeline import Pipeline
from tests.helpers.models import batch, model


def test_the_learning_rate_falls_before_rollouts_and_at_the_end() -> None:
    rates = np.array([two_cycles(step, 1000, 800) for step in range(1000)])
    assert (rates > 0).all()
    assert rates.max() == pytest.approx(1.0, abs=0.02)
    assert rates[798] < 0.01
    assert rates[800:].max() == pytest.approx(0.1, abs=0.005)
    assert rates[-1] < 0.01
    for one_step_steps in (0, 1000):
        assert all(0 < two_cycles(step, 1000, one_step_steps) <= 1 for step in range(1000))


def test_the_optimizer_is_reset_before_rollouts() -> None:
    network: Any = model("full_crps", crps={"one_step_fraction": 0.8, "steps": 10})
    assert [step for step in range(10) if network.resets_optimizer_at(step)] == [8]
    optimizer = torch.optim.AdamW(network.parameters())
    network.losses(batch(), 0)["loss"].backward()
    optimizer.step()
    for step, has_state in ((7, True), (8, False)):
        network._trainer = SimpleNamespace(global_step=step, optimizers=[optimizer])
        network.on_train_batch_start()
        assert bool(optimizer.state) is has_state


def test_the_training_options_are_those_of_the_section_crps() -> None:
    train = Config().train
    settings = CrpsSettings(Crps(steps=2505, batch_size=7, learning_rate=0.02), Network(), train)
    of_crps: dict[str, Any] = {"steps": 2505, "batch_size": 7, "learning_rate": 0.02}
    of_crps |= {"symmetries": "all", "patience": 2505, "validate_every": 2505 // EVALUATIONS}
    expected = replace(train, **of_crps)
    assert CrpsModel.training_options(settings) == expected
    assert CrpsModel.training_options(replace(settings, train=expected)) == expected


def test_the_pipeline_applies_the_training_options() -> None:
    config = Config(sections={"crps": Crps(steps=2505)})
    of_crps, of_vae = (
        Pipeline(config).train(Cell("pusher", "low", name, 0)).settings["model_settings"]["train"]
        for name in ("full_crps", "full_vae")
    )
    assert of_crps["steps"] == 2505
    assert of_vae == to_json(config.train)
