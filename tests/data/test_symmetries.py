"""The description of symmetries: it is data, and survives a file."""

import json
from dataclasses import replace

import pytest

from study.common.errors import BadInput
from study.common.progress import Progress
from study.data.symmetries import Mirror, Shift, Symmetries, Turn
from study.envs import simulators
from study.envs.observe import observe_trajectories

EVERYTHING = Symmetries(
    turn=Turn(
        states=(("x", "y"), ("vx", "vy")),
        actions=(("ax", "ay"),),
        goal=(("to_x", "to_y"),),
        angles=("yaw",),
        quarter=True,
        broken_by=("a wall is hit",),
    ),
    mirror=Mirror(states=("y", "yaw"), actions=("ay",), goal=("to_y",)),
    shifts=(Shift(-1.0, 2.0, states=("x",), goal=("to_x",)), Shift(0.0, 1.0, states=("y",))),
)


def test_json_and_back() -> None:
    assert Symmetries.from_json(json.loads(json.dumps(EVERYTHING.to_json()))) == EVERYTHING


def test_parts_that_are_left_out_have_no_effect() -> None:
    of_logs = {"mirror": {"states": ["y"]}, "shifts": [{"low": 0, "high": 1, "states": ["x"]}]}
    expected = Symmetries(mirror=Mirror(states=("y",)), shifts=(Shift(0, 1, states=("x",)),))
    assert Symmetries.from_json(of_logs) == expected


PAIRS = (("x", "y"), ("vx", "vy"))
AXIS = Turn(states=PAIRS, axis=PAIRS)


def test_the_axis_survives_json() -> None:
    turned = Symmetries(turn=AXIS)
    assert Symmetries.from_json(json.loads(json.dumps(turned.to_json()))) == turned


@pytest.mark.parametrize(
    ("symmetries", "message"),
    [
        (Symmetries(turn=replace(AXIS, axis=PAIRS[:1])), "two different pairs of turn.states"),
        (Symmetries(turn=replace(AXIS, axis=(PAIRS[0], PAIRS[0]))), "two different pairs"),
        (Symmetries(turn=replace(AXIS, axis=(PAIRS[0], ("y", "x")))), "two different pairs"),
        (Symmetries(turn=replace(AXIS, angles=("yaw",))), "leave out turn.axis"),
        (Symmetries(turn=replace(AXIS, quarter=True)), "leave out turn.axis"),
        (Symmetries(turn=replace(AXIS, actions=(("ax", "ay"),))), "leave out turn.axis"),
        (Symmetries(turn=AXIS, shifts=(Shift(0, 1, states=("vx",)),)), "leave out turn.axis"),
    ],
)
def test_an_axis_needs_two_points_that_only_turn(symmetries: Symmetries, message: str) -> None:
    names: tuple[list[str], ...] = (["x", "y", "vx", "vy", "yaw"], ["ax", "ay"], [])
    Symmetries(turn=AXIS).check("a robot", *names)
    with pytest.raises(BadInput, match=message):
        symmetries.check("a robot", *names)


def test_a_data_set_without_symmetries_has_the_trivial_group() -> None:
    assert not Symmetries.from_facts({})
    assert not Symmetries.from_facts({"symmetries": Symmetries().to_json()})
    assert all([Symmetries(turn=EVERYTHING.turn), Symmetries(mirror=EVERYTHING.mirror)])
    assert Symmetries(shifts=EVERYTHING.shifts)


@pytest.mark.parametrize("name", ["pusher", "uav"])
def test_a_data_set_has_the_symmetries_of_its_simulator(name: str) -> None:
    simulator = simulators[name](horizon=2)
    (part,) = observe_trajectories(simulator, 2, 0, Progress())
    facts = json.loads(json.dumps(part.facts))
    assert Symmetries.from_facts(facts) == simulator.symmetries != Symmetries()
