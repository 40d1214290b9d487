"""Conditions of outcomes: what they mean, and what they refuse."""

import numpy as np
import pytest

from study.common.errors import BadInput
from study.data.expressions import Condition, Expression

KNOWN = ("x", "y", "goal_x")
VALUES = {
    "x": np.array([[0.0, 1.0, 2.0], [0.0, -1.0, np.nan]]),
    "y": np.zeros((2, 3)),
    "goal_x": np.full((2, 3), 2.0),
}


@pytest.mark.parametrize(
    ("text", "so_far"),
    [
        ("x > 0.5 at any step", [[False, True, True], [False, False, False]]),
        ("x > 0.5", [[False, True, True], [False, False, False]]),
        ("x >= 0 at every step", [[True, True, True], [True, False, False]]),
        ("x > 0.5  at  the end", [[False, True, True], [False, False, False]]),
        ("hypot(x - goal_x, y) < 0.5 at any step", [[False, False, True], [False] * 3]),
        ("0 < x < 1.5 at the end", [[False, True, False], [False] * 3]),
        ("not x > 0 and y == 0 at the end", [[True, False, False], [True, True, False]]),
        ("abs(wrap(x + 2 * pi) - x) < 1e-9 at the end", [[True] * 3, [True, True, False]]),
        ("x ** 2 % 3 == 1 or -x > 0.5 at the end", [[False, True, True], [False, True, False]]),
    ],
)
def test_a_condition_up_to_each_step(text: str, so_far: list[list[bool]]) -> None:
    condition = Condition.parse(text, KNOWN, "outcomes")
    np.testing.assert_array_equal(condition.so_far(VALUES), so_far)


def test_a_value_that_is_not_finite_meets_no_condition() -> None:
    for text in ("x < 9", "not x > 9", "x != 1"):
        holds = Expression.parse(text, KNOWN, "outcomes").evaluate(
            {"x": np.array([np.nan, np.inf])}
        )
        assert not holds.any()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("z > 1 at any step", "no variable 'z'"),
        ("gaol_x > 1", "did you mean 'goal_x'"),
        ("x > 1 at any stop", "did you mean 'at any step'"),
        ("x + 1 at any step", "no comparison"),
        ("x and y > 1", "no comparison"),
        ("hypot(x) > 1", "it takes 2"),
        ("open('f') > 1", "no function 'open'"),
        ("x.real > 1", "not allowed"),
        ("x[0] > 1", "not allowed"),
        ("'a' > x", "not allowed"),
        ("(lambda: 1)() > x", "not allowed"),
        ("[1 for _ in x] > x", "not allowed"),
        ("__import__('os').system('true') > 1", "not allowed"),
        ("x is y", "not allowed"),
        ("x >", "write a condition"),
        ("", "write a condition"),
        ("(" * 5000 + "x", "characters"),
    ],
)
def test_what_is_refused(text: str, message: str) -> None:
    with pytest.raises(BadInput, match="outcomes: ") as caught:
        Condition.parse(text, KNOWN, "outcomes")
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
