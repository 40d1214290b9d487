"""How long a stage is expected to take."""

import pytest

from study.commands.display import EXPECTED, expectations
from study.workflow.task import Task


def test_the_mean_of_tasks_of_the_stage() -> None:
    ended = {Task("train", str(n), {"n": n}): seconds for n, seconds in enumerate((10.0, 30.0))}
    assert expectations(ended)("train") == 20.0


def test_without_tasks_of_the_stage_the_ratio_of_the_others() -> None:
    ended = {Task("collect", "a", {}): 3 * EXPECTED["collect"]}
    assert expectations(ended)("tune") == pytest.approx(3 * EXPECTED["tune"])
    assert expectations({})("tune") == EXPECTED["tune"]


def test_tasks_that_were_not_run_do_not_count() -> None:
    ended = {Task("train", "a", {}): 10.0, Task("evaluate", "b", {}): 0.0}
    assert expectations(ended)("train") == 10.0
    assert expectations(ended)("evaluate") == pytest.approx(
        10.0 * EXPECTED["evaluate"] / EXPECTED["train"]
    )
