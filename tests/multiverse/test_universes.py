"""Universes: the parts of a design, its balance, and what stays when the design is extended."""

import copy
from collections import Counter
from dataclasses import replace
from typing import Any

import pytest

from study.commands.settings import CONFIGS
from study.common.errors import BadInput
from study.config import strict_yaml
from study.config.tree import values_of
from study.multiverse.design import Design, Universe, check_settings, config_of_universe
from study.multiverse.read import design_from
from study.multiverse.universes import BLOCK, balanced_values, universes
from tests.helpers.multiverse import PART, design
from tests.helpers.running import configuration

FILE = CONFIGS / "multiverse.yaml"
WITHOUT_RULES: dict[str, Any] = {"exclude": []}


def committed() -> dict[str, Any]:
    part: dict[str, Any] = strict_yaml.parse(FILE.read_text(encoding="utf-8"))["multiverse"]
    return part


def random_part(planned: Design) -> list[Universe]:
    return [universe for universe in universes(planned) if universe.kind == "random"]


def columns(planned: Design) -> dict[str, list[str]]:
    """The value of each choice in the random universes, without rules and repetitions."""
    return {c.name: balanced_values(c, planned.random, planned.seed) for c in planned.choices}


def extended(count: int = 24, **choices: Any) -> Design:
    """The committed design without rules, with other or further choices."""
    part = copy.deepcopy(committed()) | WITHOUT_RULES | {"random": count}
    part["choices"] |= choices
    return design_from(part)


def test_the_universes_around_the_base_readings() -> None:
    around = [u for u in universes(design(random=0)) if u.kind != "random"]
    assert [universe.name for universe in around] == [
        "study",
        "as_written",
        "study/target=state",
        "study/beta=low",
        "study/beta=one",
        "study/features=none",
        "as_written/forecast=sample",
        "as_written/target=change",
        "as_written/beta=one",
        "as_written/features=none",
    ]
    bases = design().bases
    for universe in around:
        assert universe.base is not None
        reference = bases[universe.base]
        differing = [name for name in reference if universe.values[name] != reference[name]]
        assert differing == ([] if universe.changed is None else [universe.changed])


def test_no_universe_has_an_excluded_combination_and_none_occurs_twice() -> None:
    for planned in (design(random=48), design_from(committed())):
        found = universes(planned)
        assert all(planned.excluded(universe.values) is None for universe in found)
        assert len({tuple(universe.values.items()) for universe in found}) == len(found)
        assert len({universe.name for universe in found}) == len(found)


def test_a_base_reading_keeps_its_name_if_it_is_one_change_of_another() -> None:
    bases = {"study": {}, "as_written": {"target": "state"}}
    names = [universe.name for universe in universes(design(bases=bases, random=0))]
    assert names[:2] == ["study", "as_written"]
    assert "study/target=state" not in names
    assert "as_written/target=change" not in names


def test_an_excluded_base_reading_is_an_error() -> None:
    with pytest.raises(BadInput, match=r"bases.bad: excluded by a rule"):
        universes(design(bases={"bad": {"forecast": "mean"}}))


def test_rules_that_leave_nothing_are_an_error() -> None:
    values = ["high", "low", "one"]
    rules = [
        {"values": {"target": target, "beta": beta}, "reason": "none"}
        for target in ("change", "state")
        for beta in values
    ]
    planned = replace(design(exclude=rules), bases={})
    with pytest.raises(BadInput, match="no allowed value"):
        universes(planned)


def test_every_value_occurs_equally_often_in_each_block() -> None:
    planned = extended(3 * BLOCK)
    for choice in planned.choices:
        column = balanced_values(choice, planned.random, planned.seed)
        for first in range(0, planned.random, BLOCK):
            counts = Counter(column[first : first + BLOCK])
            assert set(counts.values()) == {BLOCK // len(choice.values)}


def test_choices_are_independent_of_each_other() -> None:
    # Over many universes, every pair of values of two choices occurs about equally often.
    planned = design(random=1200, exclude=[])
    forecast, beta = (columns(planned)[name] for name in ("forecast", "beta"))
    counts = Counter(zip(forecast, beta, strict=True))
    assert len(counts) == 6
    assert all(160 < count < 240 for count in counts.values())


def test_a_further_choice_changes_no_other_choice() -> None:
    new = {"question": "?", "values": {"a": {}, "b": {"vae.latent_size": 2}}}
    assert columns(extended(new=new)).items() >= columns(extended()).items()


def test_a_further_value_changes_its_share_of_one_choice() -> None:
    part = committed()["choices"]["features"]
    part["values"]["other"] = {"vae.latent_size": 2}
    old, new = columns(extended()), columns(extended(features=part))
    differing = [name for name in old if old[name] != new[name]]
    assert differing == ["features"]
    pairs = list(zip(old["features"], new["features"], strict=True))
    assert Counter(new["features"]) == {"product": 8, "none": 8, "other": 8}
    # A third of the universes gets the new value; few others change to keep the balance.
    assert sum(b == "other" for _, b in pairs) == 8
    assert sum(a != b != "other" for a, b in pairs) <= 4


def test_more_random_universes_leave_complete_blocks_as_they_are() -> None:
    old, new = columns(extended(BLOCK)), columns(extended(3 * BLOCK))
    assert all(new[name][:BLOCK] == column for name, column in old.items())


def test_another_seed_gives_other_universes() -> None:
    one, two = (columns(replace(extended(), seed=seed)) for seed in (0, 1))
    assert all(one[name] != two[name] for name in one)


def test_the_committed_design_is_as_large_as_it_says() -> None:
    planned = design_from(committed())
    assert len(random_part(planned)) >= 24
    for base in planned.bases:
        changed = {u.changed for u in universes(planned) if u.base == base}
        # A change of the study to the decoder's mean is excluded, and so is its inverse.
        missing = {"decoder_output"} if base == "study" else set()
        assert changed == {None, *(choice.name for choice in planned.choices)} - missing


@pytest.mark.parametrize(("base", "file"), [("study", "quick"), ("as_written", "as_written")])
def test_the_base_readings_are_those_of_the_other_files(base: str, file: str) -> None:
    planned = design_from(committed())
    shared = configuration("--config", str(CONFIGS / "quick.yaml"))
    universe = next(u for u in universes(planned) if u.name == base)
    found = values_of(config_of_universe(shared, planned, universe))
    assert found.pop("grid.seeds") == (0, 1)  # that of the file, and the further seed
    expected = values_of(configuration("--config", str(CONFIGS / f"{file}.yaml")))
    assert expected.pop("grid.seeds") == (0,)
    differing = {name for name in expected if found[name] != expected[name]}
    assert differing <= {"name", "grid.models"}


def test_settings_that_a_choice_would_replace_unnoticed_are_an_error() -> None:
    planned = design_from(committed())
    check_settings(configuration(), planned)
    with pytest.raises(BadInput, match=r"train.steps: got 7, but the choice 'training' sets it"):
        check_settings(configuration("--train.steps=7"), planned)


def test_only_base_readings_have_the_further_seeds() -> None:
    planned = design_from(PART)
    seeds = {
        universe.kind: config_of_universe(configuration(), planned, universe).grid.seeds
        for universe in universes(planned)
    }
    assert seeds == {"base": (0, 1), "one change": (0,), "random": (0,)}
    config = configuration("--grid.seeds=[0, 1]")
    assert {
        config_of_universe(config, planned, universe).grid.seeds for universe in universes(planned)
    } == {(0, 1)}


def test_a_universe_with_settings_that_do_not_go_together_is_named() -> None:
    part = copy.deepcopy(PART)
    part["choices"]["beta"]["values"]["one"] = {"tune.beta_low": 1.0e5}
    planned = design_from(part)
    universe = next(u for u in universes(planned) if u.name == "study/beta=one")
    with pytest.raises(BadInput, match=r"universe study/beta=one: tune.beta_low: got 100000"):
        config_of_universe(configuration(), planned, universe)
