"""A model is the same after saving and loading, and a file of another version is an error."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from study.common.errors import StudyError
from study.models.checkpoints import load_model, save_model
from tests.helpers.models import model
from tests.models.test_base import ALL, Changes, heteroscedastic, scenarios


@pytest.mark.parametrize(("name", "changes"), ALL)
def test_a_loaded_model_is_the_same(name: str, changes: Changes, tmp_path: Path) -> None:
    forecaster, (s0, actions, seeds) = heteroscedastic(name, changes), scenarios()
    path = tmp_path / "model.safetensors"
    save_model(forecaster, name, path, beta=0.1)
    loaded = load_model(path)
    expected = forecaster.forecast(s0, actions, 4, seeds)
    np.testing.assert_array_equal(loaded.forecast(s0, actions, 4, seeds), expected)
    assert type(loaded.settings) is type(forecaster.settings)
    assert loaded.settings == forecaster.settings
    written = path.read_bytes()
    save_model(loaded, name, path, beta=0.1)
    assert path.read_bytes() == written


def rename_a_setting(facts: dict[str, Any], tensors: dict[str, Any]) -> None:
    facts["settings"]["vae"]["width"] = facts["settings"]["vae"].pop("variance")


def drop_a_section(facts: dict[str, Any], tensors: dict[str, Any]) -> None:
    del facts["settings"]["vae"]


def rename_the_model(facts: dict[str, Any], tensors: dict[str, Any]) -> None:
    facts["model"] = "wide_vae"


def rename_a_weight(facts: dict[str, Any], tensors: dict[str, Any]) -> None:
    tensors["cvae.decoder.width.weight"] = tensors.pop("cvae.decoder.log_std.weight")


def drop_a_unit(facts: dict[str, Any], tensors: dict[str, Any]) -> None:
    del tensors["state_mean"]


@pytest.mark.parametrize(
    "change", [rename_a_setting, drop_a_section, rename_the_model, rename_a_weight, drop_a_unit]
)
def test_weights_of_another_version_are_an_error(
    change: Callable[[dict[str, Any], dict[str, Any]], None], tmp_path: Path
) -> None:
    path = tmp_path / "model.safetensors"
    save_model(model("full_vae"), "full_vae", path, beta=0.1)
    with safe_open(path, framework="np") as file:
        facts = json.loads(file.metadata()["facts"])
    tensors = load_file(path)
    change(facts, tensors)
    save_file(tensors, path, {"facts": json.dumps(facts)})
    with pytest.raises(StudyError, match="another version of the study wrote these weights") as e:
        load_model(path)
    assert "\n" not in str(e.value)


def test_a_missing_or_damaged_file_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "model.safetensors"
    with pytest.raises(StudyError, match="is missing or damaged"):
        load_model(path)
    save_model(model("full_vae"), "full_vae", path, beta=0.1)
    whole = path.read_bytes()
    for content in (b"", b"nothing", whole[:100], whole[:-100]):
        path.write_bytes(content)
        with pytest.raises(StudyError, match="is missing or damaged") as error:
            load_model(path)
        assert "\n" not in str(error.value)
    save_file({}, path)  # a file of another program, without facts
    with pytest.raises(StudyError, match="is missing or damaged"):
        load_model(path)
