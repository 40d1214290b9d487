"""Values of settings, from files, flags and stored studies."""

import json
import math
from dataclasses import replace
from fractions import Fraction
from typing import Any

import pytest

from study.common.errors import BadInput
from study.config.grid import cells
from study.config.settings import Config, Tune
from study.config.stage_settings import TrainingSet
from study.config.tree import config_of, flatten, from_json, help_texts, keys, to_json


def test_no_value_gives_the_defaults() -> None:
    assert config_of({}) == Config()


def test_what_is_stored_is_read() -> None:
    config = config_of({"tune.trials": 9, "vae.latent_size": 3, "grid.levels": {"tiny": 0.01}})
    stored = json.loads(json.dumps(to_json(config)))
    assert stored["vae"]["latent_size"] == 3
    assert from_json(stored) == config


def test_a_stored_study_that_lacks_a_setting() -> None:
    stored = to_json(Config())
    del stored["tune"]["trials"]
    with pytest.raises(BadInput, match=r"the setting 'tune.trials' is missing"):
        from_json(stored)
    stored = to_json(Config())
    del stored["engine"]
    assert from_json(stored, unknown=("engine",)) == Config()


def test_a_study_of_before_a_setting_is_read_and_written_as_it_was() -> None:
    stored = to_json(Config())
    assert "batch" not in stored["tune"]
    assert from_json(stored) == Config()
    changed = config_of({"tune.batch": 2, "train.precision": "bf16"})
    stored = to_json(changed)
    assert (stored["tune"]["batch"], stored["train"]["precision"]) == (2, "bf16")
    assert from_json(stored) == changed


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("tune.trials", None, "got null; it must be a whole number"),
        ("tune.trials", True, "got true; it must be a whole number"),
        ("tune.trials", 1.0, "got 1.0; it must be a whole number"),
        ("tune.trials", "3", "got '3'; it must be a whole number"),
        ("tune.beta_low", float("inf"), "got inf; it must be a number"),
        ("tune.beta_low", float("nan"), "got nan; it must be a number"),
        ("tune.beta_low", 10**400, "it must be a number"),
        ("tune.beta_low", 0, "it must be at least 1e-12"),
        ("ensemble.cross_fit", 1, "got 1; it must be true or false"),
        ("ensemble.cross_fit", "yes", "got 'yes'; it must be true or false"),
        ("name", 2024, "write '2024' with quotes"),
        ("grid.seeds", None, "got null; it must be a list of whole numbers"),
        ("grid.seeds", [0, None], "got null in it; it must be a list of whole numbers"),
        ("grid.seeds", [2**63], "it must be between 0 and 9223372036854775807"),
        ("grid.environments", ["a", 1], "got 1 in it"),
        ("collect.horizon", 1.5, "a whole number or null"),
        ("evaluate.samples", 10**9, "it must be between 2 and 10000"),
        ("grid.levels", {"low": None}, "got 'low': null in it"),
        ("grid.levels", {"low": 1.5}, "it must be between 1e-09 and 1.0"),
        ("grid.levels", {"a/b": 1}, "'a/b' cannot name a level"),
        ("grid.levels", ["tiny"], "or give its fraction of the data: '{tiny: 0.5}'"),
        ("grid.levels", {"tiny": 1e-6}, "level tiny needs at least 2"),
        ("crps.trajectory_latent_size", -1, "it must be between 0 and 1000"),
    ],
)
def test_a_value_that_is_not_plainly_what_is_wanted(key: str, value: Any, expected: str) -> None:
    with pytest.raises(BadInput, match=rf"^{key.partition('.')[0]}|^collect.trajectories") as error:
        config_of({key: value})
    assert expected in str(error.value)


def test_a_whole_number_may_stand_for_a_number() -> None:
    found = config_of({"train.weight_decay": 3, "collect.horizon": None})
    assert found.train.weight_decay == 3.0
    assert isinstance(found.train.weight_decay, float)


def test_sections_and_settings_are_not_confused() -> None:
    assert flatten({"tune": {"trials": 3}, "name": "x"}) == {"tune.trials": 3, "name": "x"}
    assert flatten({"grid": {"levels": {"low": 1}}}) == {"grid.levels": {"low": 1}}
    for content, expected in (
        ({"tune": None}, "tune: got null; it must be a section"),
        ({"tune": {"trials": 1}, "trials": 2}, "unknown setting 'trials'"),
        ({"mode": {}}, "unknown setting 'mode'"),
    ):
        with pytest.raises(BadInput, match=expected):
            flatten(content)


def test_every_setting_is_explained() -> None:
    texts = help_texts()
    assert list(texts) == keys()
    assert all(texts.values())


def test_levels_stand_in_the_order_of_their_data() -> None:
    config = config_of({"grid.levels": {"tiny": 0.01, "high": 0.1, "low": 1}, "grid.seeds": [0]})
    assert list(config.grid.levels.items()) == [("low", 1.0), ("high", 0.1), ("tiny", 0.01)]
    assert list(dict.fromkeys(cell.level for cell in cells(config))) == ["low", "high", "tiny"]
    assert config_of({"grid.levels": ["high", "low"]}).grid == Config().grid


@pytest.mark.parametrize("total", [20, 40, 57, 999, 3000, 10000, 10**6])
@pytest.mark.parametrize("seed", [0, 1, 7, 9, 10, 23])
def test_the_papers_levels_are_all_and_a_tenth(total: int, seed: int) -> None:
    assert TrainingSet.of_level(1.0, total, seed) == TrainingSet(0, total)
    tenth = TrainingSet(seed % 10 * (total // 10), total // 10)
    assert TrainingSet.of_level(0.1, total, seed) == tenth


@pytest.mark.parametrize("fraction", [0.01, 0.03, 0.25, 0.3, 0.5, 0.7, 0.999])
def test_a_part_lies_within_the_data(fraction: float) -> None:
    for total in (2, 57, 1000):
        for seed in range(120):
            part = TrainingSet.of_level(fraction, total, seed)
            assert part.trajectories == math.floor(Fraction(str(fraction)) * total)
            assert part.first + part.trajectories <= total
    firsts = {TrainingSet.of_level(0.25, 1000, seed).first for seed in range(8)}
    assert firsts == {0, 250, 500, 750}


def test_a_changed_setting_is_another_configuration() -> None:
    assert replace(Config(), tune=Tune(trials=9)) != Config()
    assert config_of({"vae.hidden_size": 7}) != Config()
