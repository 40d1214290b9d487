"""The scores that `ablate` compares."""

import json
from pathlib import Path

import pytest

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
