"""The scores that `ablate` compares."""

import json
from pathlib import Path

import numpy as np
import pytest

from study.common.arrays import Array, Floats
from study.common.files import read_json
from study.common.progress import Progress
from study.config.settings import Collect
from study.config.stage_settings import CollectSettings, ValidateSettings
from study.examples.cart import Cart
from study.models.oracle import Oracle
from study.stages import collect, validate


def test_the_oracle_is_perfect_and_the_test_set_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    data.mkdir()
    out.mkdir()
    sizes = Collect(trajectories=40, validation=400, scenarios=2, rollouts=2, horizon=20)
    collect.run(CollectSettings("cart", sizes), {}, data, Progress())
    (data / "test.safetensors").unlink()
    (tmp_path / "fit.json").write_text(json.dumps({"beta": 0.5}))
    monkeypatch.setattr(validate, "load_model", lambda _: Oracle(Cart(horizon=20)))
    inputs = {"data": data, "trained": tmp_path}
    validate.run(ValidateSettings("cart", seed=3, samples=20), inputs, out, Progress())
    found = read_json(out / "validation.json")
    assert found["beta"] == 0.5
    assert abs(found["mmd2"]) < 0.01
    assert found["brier_skill"] == pytest.approx(1.0, abs=0.15)
    assert found["variance_ratio"] == pytest.approx(1.0, abs=0.1)


class Diverging(Oracle):
    """Forecasts that become NaN, in one of four samples."""

    def forecast(self, s0: Array, actions: Array, samples: int, seeds: Array) -> Floats:
        forecasts = super().forecast(s0, actions, samples, seeds)
        forecasts[:, ::4, -1] = np.nan
        return forecasts


def test_forecasts_that_are_not_finite_cost_skill(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cart that goes nowhere near its goal: a sample without an outcome is no correct failure."""
    sizes = Collect(trajectories=8, validation=30, scenarios=2, rollouts=2, horizon=20)
    collect.run(CollectSettings("cart", sizes), {}, tmp_path, Progress())
    (tmp_path / "fit.json").write_text(json.dumps({"beta": None}))
    inputs = {"data": tmp_path, "trained": tmp_path}
    skills = []
    for model in (Oracle, Diverging):
        monkeypatch.setattr(validate, "load_model", lambda _, m=model: m(Cart(horizon=20)))
        validate.run(ValidateSettings("cart", seed=3, samples=20), inputs, tmp_path, Progress())
        found = read_json(tmp_path / "validation.json")
        skills.append(found["brier_skill"])
    assert skills[0] - skills[1] > 0.2
    assert found["variance_ratio"] == np.inf
