"""The settings of a recorded system: what they mean, and what is refused at load."""

from dataclasses import replace

import numpy as np
import pytest

from study.common.errors import BadInput
from study.config.recorded import Column
from study.data.recorded.description import Description
from tests.helpers.logs import SETTINGS

FULL = replace(
    SETTINGS,
    files=("log.csv",),
    state=("x [m]", "y = pose.y [m]", "yaw [rad]"),
    goal=("goal_x", "goal_y"),
    angles=("yaw",),
)


@pytest.mark.parametrize(
    ("text", "column"),
    [
        ("x", Column("x", "x", "1")),
        ("x [m/s]", Column("x", "x", "m/s")),
        ("x = pose.x [m]", Column("x", "pose.x", "m")),
        ("q0 = att.q[0]", Column("q0", "att.q[0]", "1")),
        ("q0 = att.q[0] [1]", Column("q0", "att.q[0]", "1")),
    ],
)
def test_a_variable_has_a_name_a_column_and_a_unit(text: str, column: Column) -> None:
    assert Column.parse(text) == column


def test_outcomes_use_states_angles_and_the_goal() -> None:
    settings = replace(
        FULL,
        angles_as="sine_cosine",
        outcomes=("arrives = hypot(x - goal_x, y - goal_y) < 0.5 at any step", "turned = yaw > 1"),
    )
    system = Description("bot", settings)
    system.check()
    assert [v.name for v in system.state] == ["x", "y", "sin_yaw", "cos_yaw"]
    states = np.array([[[0.0, 0.0, 0.0, 1.0], [1.0, 1.0, np.sin(2), np.cos(2)]]])
    goal = np.array([[1.0, 1.2]])
    values = system.values(states, goal)
    happens = {name: c.so_far(values)[..., -1].tolist() for name, c in system.conditions.items()}
    assert happens == {"arrives": [True], "turned": [True]}


def test_symmetries_are_named() -> None:
    settings = replace(
        FULL,
        turn=("x y", "goal_x goal_y"),
        turn_angles=("yaw",),
        mirror=("y", "yaw", "goal_y", "u"),
        shifts=("x goal_x = 20",),
    )
    symmetries = Description("bot", settings).symmetries
    assert symmetries.turn.states == (("x", "y"),)
    assert symmetries.turn.goal == (("goal_x", "goal_y"),)
    assert symmetries.mirror.actions == ("u",)
    assert (symmetries.shifts[0].low, symmetries.shifts[0].high) == (-20.0, 20.0)
    assert symmetries.shifts[0].goal == ("goal_x",)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"state": ()}, "bot.state: got an empty list"),
        ({"action": ()}, "bot.action: got an empty list"),
        ({"state": ("x [m", "y")}, "NAME = COLUMN [UNIT]"),
        ({"state": ("= x", "y")}, "NAME = COLUMN [UNIT]"),
        ({"state": ("x", "x")}, "'x' is named twice"),
        ({"action": ("x",)}, "two variables are named 'x'"),
        ({"angles": ("yow",)}, "bot.angles: no variable 'yow'; did you mean 'yaw'"),
        ({"position": ("x",)}, "give two or three"),
        ({"position": ("x", "z")}, "bot.position: no variable 'z'"),
        ({"outcomes": ("far = z > 1",)}, "bot.outcomes: 'far': no variable 'z'"),
        ({"outcomes": ("x > 1",)}, "write arrives = x > 3 at any step"),
        ({"outcomes": ("far = x > 1", "far = x > 2")}, "two are named 'far'"),
        ({"exclude": ("z > 1",)}, "bot.exclude: no variable 'z'"),
        ({"turn": ("x",)}, "give 2 names"),
        ({"turn": ("x z",)}, "bot.turn: no variable 'z'"),
        ({"mirror": ("z",)}, "bot.mirror: no variable 'z'"),
        ({"shifts": ("x = far",)}, "the amount must be a positive number"),
        ({"shifts": ("x = -3",)}, "the amount must be a positive number"),
        ({"interval": 0.1}, "bot.interval: got 0.1 and a time column 't'; give one of the two"),
        ({"rotating_pairs": ("x y roll",)}, "bot.rotating_pairs: no variable 'roll'"),
        ({"validation": 0.6, "test": 0.4}, "must be less than 1"),
    ],
)
def test_what_is_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(BadInput) as caught:
        Description("bot", replace(FULL, **changes)).check()  # type: ignore[arg-type]
    assert message in str(caught.value)
