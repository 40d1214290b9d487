"""Sections of recorded systems: when a section is one, and which settings are stored."""

import pytest

from study.common.errors import BadInput
from study.config.grid import cells
from study.config.recorded import recorded_of, register_recorded
from study.config.stage_settings import TrainingSet
from study.config.tree import config_of, flatten, from_json, to_json

CONTENT = {
    "grid": {"environments": ["bot", "pusher"], "levels": ["low"], "models": ["full_vae"]},
    "bot": {"files": ["*.csv"], "state": ["x"], "action": ["u"]},
}


def test_a_section_named_in_the_grid_is_a_recorded_system() -> None:
    register_recorded(CONTENT)
    config = config_of(flatten(CONTENT))
    recorded = recorded_of(config, "bot")
    assert recorded is not None
    assert recorded.files == ("*.csv",)
    assert recorded_of(config, "pusher") is None
    models = {
        name: [c.model for c in cells(config) if c.environment == name]
        for name in ("bot", "pusher")
    }
    assert models["pusher"] == ["full_vae", "oracle", "ensemble"]
    assert "oracle" not in models["bot"]
    assert {"training_climatology", "persistence", "analogues"} < set(models["bot"])
    assert from_json(to_json(config)) == config


def test_another_study_does_not_have_the_section() -> None:
    register_recorded(CONTENT)
    register_recorded({"grid": {"environments": ["pusher"]}})
    config = config_of({"grid.environments": ["bot"]})
    assert recorded_of(config, "bot") is None
    assert "bot" not in to_json(config)


def test_a_misspelt_section_or_setting_is_no_recorded_system() -> None:
    content = {"grid": {"environments": ["pusher"]}, "colect": {"scenarios": 3}}
    register_recorded(content)
    with pytest.raises(BadInput, match="unknown setting 'colect'"):
        flatten(content)
    content = {"bot": CONTENT["bot"] | {"horizn": 3}}
    register_recorded(content)
    with pytest.raises(BadInput, match=r"did you mean 'bot\.horizon'"):
        flatten(content)


@pytest.mark.parametrize("name", ["oracle", "analogues", "a b"])
def test_a_name_that_cannot_be_used(name: str) -> None:
    with pytest.raises(BadInput, match=f"'{name}' cannot name"):
        register_recorded({name: CONTENT["bot"]})


@pytest.mark.parametrize(
    ("fraction", "seed", "rows"),
    [
        (1.0, 0, (0, 55)),
        (1.0, 7, (0, 55)),
        (0.5, 0, (0, 15)),
        (0.5, 1, (15, 55)),
        (0.2, 3, (21, 36)),
        (0.01, 0, (0, 1)),
    ],
)
def test_a_level_has_whole_trajectories(fraction: float, seed: int, rows: tuple[int, int]) -> None:
    """Ten trajectories with 1, 2, … 10 windows."""
    chosen = TrainingSet.of_recorded(fraction, seed).rows(list(range(1, 11)))
    assert (chosen.start, chosen.stop) == rows
