"""The design in a file of settings: what it may hold, and the errors about the rest."""

import copy
from typing import Any

import pytest

from study.common.errors import BadInput
from study.config import strict_yaml
from study.multiverse import read
from study.multiverse.read import design_from
from tests.helpers.multiverse import PART, design


def test_a_base_reading_has_the_first_value_of_every_choice_that_it_does_not_name() -> None:
    first = {"forecast": "sample", "target": "change", "beta": "high", "features": "product"}
    assert design().bases["study"] == first
    assert design().bases["as_written"]["beta"] == "low"


def test_the_settings_of_a_reading() -> None:
    planned = design()
    assert planned.settings(planned.bases["as_written"]) == {
        "vae.decoder_output": "mean",
        "vae.target": "state",
        "tune.beta_low": 0.001,
        "tune.beta_high": 1.0,
        "network.features": "product",
    }


def test_the_example_of_the_documentation_is_a_design() -> None:
    lines = [line for line in (read.__doc__ or "").splitlines() if line.startswith("    ")]
    planned = design_from(strict_yaml.parse("\n".join(lines))["multiverse"])
    assert [choice.name for choice in planned.choices] == ["variance", "target"]
    assert planned.bases["as_written"] == {"variance": "homoscedastic", "target": "delta"}
    assert planned.excluded(planned.bases["as_written"]) is not None


def changed(path: str, value: Any) -> dict[str, Any]:
    """`PART` with one entry replaced, or removed if the value is None."""
    part = copy.deepcopy(PART)
    *parents, last = path.split("/")
    inner = part
    for key in parents:
        inner = inner[int(key)] if isinstance(inner, list) else inner[key]
    if value is None:
        del inner[last]
    else:
        inner[last] = value
    return part


@pytest.mark.parametrize(
    ("path", "value", "expected"),
    [
        ("bases", None, "multiverse: 'bases' is missing"),
        ("bases", {}, "at least one base reading"),
        ("choice", {}, "unknown entry 'choice'; did you mean 'choices'?"),
        ("random", 2.5, "multiverse.random: got 2.5; it must be a whole number"),
        ("random", -1, "multiverse.random: got -1"),
        ("further_seeds", 1, "multiverse.further_seeds: got 1; it must be a list of seeds"),
        ("further_seeds", [1, 2.5], "multiverse.further_seeds: got 2.5"),
        ("further_seeds", [1, 1], "a seed is there twice"),
        ("bases/as_written/target", "stat", "got 'stat'; did you mean 'state'?"),
        ("bases/as_written/target", ["state"], "as_written.target: got "),
        ("bases/as_written/target", {"a": 1}, "as_written.target: got "),
        ("bases/as_written/tarket", "state", "unknown choice 'tarket'; did you mean 'target'?"),
        ("bases/As written", {}, "got the name 'As written'; use lower-case letters"),
        (
            "choices/target/question",
            3,
            "multiverse.choices.target.question: got 3; it must be text",
        ),
        ("choices/target/question", None, "multiverse.choices.target: 'question' is missing"),
        ("choices/target/values", {"change": {}}, "a choice needs at least 2 values"),
        ("choices/target/values/state", {"vae.targt": "state"}, "did you mean 'vae.target'?"),
        ("choices/target/values/state", {"vae.target": "stat"}, "values.state: vae.target: got"),
        ("choices/target/values/state", {"vae.decoder_output": "mean"}, "in one choice only"),
        ("choices/target/values/state", "state", "got 'state'; it must be a section"),
        ("exclude", {}, "multiverse.exclude: got a section of settings; it must be a list"),
        ("exclude/0/values", {"beta": "low"}, "rule 1: a combination needs at least 2 choices"),
        ("exclude/0/reason", None, "rule 1: 'reason' is missing"),
    ],
)
def test_what_a_design_may_not_hold(path: str, value: Any, expected: str) -> None:
    with pytest.raises(BadInput) as error:
        design_from(changed(path, value))
    assert expected in str(error.value)


def test_names_of_values_may_look_like_numbers() -> None:
    text = """
    bases: {study: {}, wide: {size: 8, gate: true}}
    choices:
      size: {question: width, values: {4: {}, 8: {vae.hidden_size: 8}}}
      gate: {question: target, values: {false: {}, true: {vae.target: state}}}
    """
    planned = design_from(strict_yaml.parse(text))
    assert planned.bases["wide"] == {"size": "8", "gate": "true"}


def test_a_file_without_a_design() -> None:
    with pytest.raises(BadInput, match=r"missing in the file of settings; see configs/multiverse"):
        design_from(None)
