"""How long a study is said to take."""

import pytest

from study.commands.display import EXPECTED, expectations
from study.workflow.task import Task


def test_a_stage_is_expected_to_take_what_others_of_its_kind_took() -> None:
    ended = {Task("train", str(n), {"n": n}): seconds for n, seconds in enumerate((10.0, 30.0))}
    assert expectations(ended)("train") == 20.0


def test_a_kind_that_has_not_ended_is_slower_by_as_much_as_the_others() -> None:
    ended = {Task("collect", "a", {}): 3 * EXPECTED["collect"]}
    assert expectations(ended)("tune") == pytest.approx(3 * EXPECTED["tune"])
    assert expectations({})("tune") == EXPECTED["tune"]


def test_what_was_never_begun_says_nothing() -> None:
    ended = {Task("train", "a", {}): 10.0, Task("evaluate", "b", {}): 0.0}
    assert expectations(ended)("train") == 10.0
    assert expectations(ended)("evaluate") == pytest.approx(
        10.0 * EXPECTED["evaluate"] / EXPECTED["train"]
    )
