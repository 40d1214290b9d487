"""Settings of a model's own."""

from dataclasses import dataclass
from typing import Any

import pytest

from study.commands.settings import change
from study.common.errors import BadInput
from study.config import sections
from study.config.grid import Cell
from study.config.sections import descriptions, register_own, section, setting
from study.config.settings import Config, Grid, Train
from study.config.tree import config_of, from_json, keys, to_json
from study.models import models
from study.models.base import Model
from study.workflow.pipeline import Pipeline


@dataclass(frozen=True)
class MineSettings:
    """Settings of a test.

    Args:
        train: how it is trained.
        size: hidden units
            of a layer.
        kind: a choice.
    """

    train: Train
    size: int = setting(8, low=1, high=64)
    kind: str = setting("relu", choices=("relu", "tanh"))
    scales: tuple[float, ...] = (1.0,)
    limit: float | None = None

    def __post_init__(self) -> None:
        if self.limit is not None and self.limit > self.size:
            raise ValueError("limit must be at most size")


class Mine(Model[MineSettings]):
    """A model that is never fitted."""

    settings_class = MineSettings

    def losses(self, batch: Any, step: int) -> Any: ...

    def sample(self, s0: Any, actions: Any, noise: Any, member: Any) -> Any: ...


@pytest.fixture
def mine(monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of the registered model."""
    monkeypatch.setattr(sections, "_registered", dict(sections.registered()))
    monkeypatch.setattr(models, "_members", dict(models._members))
    models.register("my-model")(Mine)
    return "my-model"


def test_it_is_a_section_of_its_own(mine: str) -> None:
    assert f"model.{mine}.size" in keys()
    config = config_of({f"model.{mine}.size": 3, f"model.{mine}.scales": [1, 2], "train.steps": 7})
    settings = Mine.settings_from(config, mine)
    assert settings == MineSettings(Train(steps=7), 3, "relu", (1.0, 2.0))
    assert Mine.settings_from(config) == MineSettings(Train(steps=7))
    assert change(config, [f"--model.{mine}.kind=tanh"]) != config


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("size", 65, "got 65; it must be between 1 and 64"),
        ("size", "x", "it must be a whole number"),
        ("kind", "relo", "did you mean 'relu'"),
        ("limit", "x", "it must be a number or null"),
    ],
)
def test_its_values_are_checked(mine: str, key: str, value: Any, expected: str) -> None:
    with pytest.raises(BadInput, match=expected):
        config_of({f"model.{mine}.{key}": value})


def test_the_class_may_refuse_values_together(mine: str) -> None:
    config = config_of({f"model.{mine}.limit": 9})
    with pytest.raises(BadInput, match=r"model.my-model: limit must be at most size"):
        Mine.settings_from(config, mine)


def test_the_nearest_is_named(mine: str) -> None:
    with pytest.raises(BadInput, match=r"did you mean 'model.my-model.size'"):
        change(Config(), [f"--model.{mine}.sise=3"])
    with pytest.raises(BadInput, match=r"did you mean 'model.my-model'"):
        change(Config(), ["--model.my-modle.size=3"])


def test_they_are_part_of_the_key_of_that_model_alone(mine: str) -> None:
    names = (mine, "probabilistic_mlp")
    config = config_of({"grid.models": names})
    changed = change(config, [f"--model.{mine}.size=3"])
    for name in names:
        cell = Cell("uav", "low", name, 0)
        one, other = (Pipeline(each).train(cell) for each in (config, changed))
        assert (one.key != other.key) == (name == mine)
    settings = Pipeline(changed).train(Cell("uav", "low", mine, 0)).settings
    assert settings["model_settings"]["size"] == 3


def test_a_study_stores_the_settings_of_its_own_models(mine: str) -> None:
    assert "model" not in to_json(Config())
    config = config_of({"grid.models": [mine], f"model.{mine}.size": 3})
    stored = to_json(config)
    assert stored["model"][mine]["size"] == 3
    assert from_json(stored) == config
    del stored["model"]
    with pytest.raises(BadInput, match=r"model.my-model.size' is missing"):
        from_json(stored)
    # A study of other models says nothing about this one.
    assert from_json(to_json(Config(grid=Grid(models=("full_vae",))))).sections


def test_what_a_docstring_says() -> None:
    found = descriptions(MineSettings)
    assert found == {"train": "how it is trained.", "size": "hidden units of a layer."} | {
        "kind": "a choice."
    }


@dataclass(frozen=True)
class WithoutDefault:
    size: int


@dataclass(frozen=True)
class OfAnotherType:
    size: object = None


@dataclass(frozen=True)
class OutOfBounds:
    size: int = setting(0, low=1)


@dataclass(frozen=True)
class WrongDefault:
    size: int = setting("x")


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        (WithoutDefault, "the setting 'size' has no default"),
        (OfAnotherType, "has the type"),
        (OutOfBounds, "got 0; it must be at least 1"),
        (WrongDefault, "got 'x'; it must be a whole number"),
    ],
)
def test_a_setting_that_cannot_be_one(wrong: type, expected: str) -> None:
    with pytest.raises(BadInput, match=expected):
        register_own("wrong", wrong)
    assert "model.wrong" not in sections.registered()


def test_several_models_may_share_a_section(mine: str) -> None:
    @section("shared")
    @dataclass(frozen=True)
    class Shared:
        depth: int = setting(2, low=1)

    assert config_of({"shared.depth": 3}).section("shared") == Shared(3)
    with pytest.raises(BadInput, match="cannot name a section"):
        section("a.b")(Shared)
