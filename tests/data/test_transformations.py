"""Transformations of trajectories: each follows its definition, and the group is sampled evenly."""

import numpy as np
import pytest

from study.common.arrays import Floats
from study.data.normalization import Normalization
from study.data.symmetries import Mirror, Shift, Symmetries, Turn
from study.data.trajectories import Trajectories
from study.data.transformations import COPIES, SymmetryGroup, orbit_parts

STATE, ACTION, GOAL = ("x", "y", "z", "yaw"), ("ay", "ax", "gain"), ("to_x", "to_y")
TURN = Turn(
    states=(("x", "y"),), actions=(("ax", "ay"),), goal=(("to_x", "to_y"),), angles=("yaw",)
)
MIRROR = Mirror(states=("y", "yaw"), actions=("ay",), goal=("to_y",))
SHIFT = Shift(-3.0, 5.0, states=("x",), goal=("to_x",))
ALL = Symmetries(TURN, MIRROR, (SHIFT,))
FACTS = {
    "state": [{"name": name} for name in STATE],
    "action": [{"name": name} for name in ACTION],
    "goal": [{"name": name} for name in GOAL],
    "symmetries": ALL.to_json(),
}


def trajectories(count: int = 40, horizon: int = 6) -> Trajectories:
    generator = np.random.default_rng(0)
    states = generator.normal(3.0, 2.0, (count, horizon + 1, 4)).astype(np.float32)
    actions = generator.normal(1.0, 2.0, (count, horizon, 3)).astype(np.float32)
    goal = generator.normal(size=(count, 2)).astype(np.float32)
    return Trajectories(states, actions, goal, np.zeros((count, 0), np.float32), FACTS)


def group(symmetries: Symmetries = ALL) -> SymmetryGroup:
    return SymmetryGroup(symmetries, STATE, ACTION, GOAL)


def test_a_transformation_mirrors_then_turns_then_shifts() -> None:
    data, count = trajectories(), 40
    generator = np.random.default_rng(1)
    angle, mirrored = generator.uniform(-3, 3, count), np.arange(count) % 2 == 1
    shift = generator.uniform(-3, 5, (count, 1))
    found = group().transformations(data.states[:, 0], angle, mirrored, shift)
    sign = np.where(mirrored, -1.0, 1.0)
    cos, sin = np.cos(angle), np.sin(angle)

    def turned(x: Floats, y: Floats) -> tuple[np.ndarray, np.ndarray]:
        if x.ndim == 2:
            c, s, m = cos[:, None], sin[:, None], sign[:, None]
        else:
            c, s, m = cos, sin, sign
        return c * x - s * m * y, s * x + c * m * y

    states, actions, goal = (
        found.states(data.states),
        found.actions(data.actions),
        found.goal(data.goal),
    )
    x, y = turned(data.states[..., 0], data.states[..., 1])
    np.testing.assert_allclose(states[..., 0], x + shift, atol=1e-5)
    np.testing.assert_allclose(states[..., 1], y, atol=1e-5)
    np.testing.assert_array_equal(states[..., 2], data.states[..., 2])
    x, y = turned(data.actions[..., 1], data.actions[..., 0])
    np.testing.assert_allclose(actions[..., [1, 0]], np.stack([x, y], -1), atol=1e-5)
    np.testing.assert_array_equal(actions[..., 2], data.actions[..., 2])
    x, y = turned(data.goal[:, 0], data.goal[:, 1])
    np.testing.assert_allclose(goal, np.stack([x + shift[:, 0], y], -1), atol=1e-5)
    # The angle is moved by whole turns, of the whole trajectory.
    yaw = sign[:, None] * data.states[..., 3] + angle[:, None]
    moved = (states[..., 3] - yaw) / (2 * np.pi)
    np.testing.assert_allclose(moved, np.round(moved[:, :1]).repeat(7, 1), atol=1e-5)
    assert (np.abs(states[:, 0, 3]) <= np.pi + 1e-5).all()
    assert states.dtype == actions.dtype == goal.dtype == np.float32


def test_forecasts_are_transformed_as_their_trajectory() -> None:
    data = trajectories()
    found = group().sample(np.random.default_rng(0), data.states[:, 0])
    forecasts = data.states[:, None].repeat(3, axis=1)
    for member in range(3):
        expected = found.states(data.states)
        np.testing.assert_allclose(found.states(forecasts)[:, member], expected, atol=1e-5)


def test_quarter_turns_are_exact() -> None:
    data, count = trajectories(), 40
    turn = Symmetries(Turn(states=(("x", "y"),), quarter=True))
    quarters = np.pi / 2 * (np.arange(count) % 4).astype(np.float64)
    never, still = np.zeros(count, bool), np.zeros((count, 0))
    found = group(turn).transformations(data.states[:, 0], quarters, never, still)
    states, x, y = found.states(data.states), data.states[..., 0], data.states[..., 1]
    for quarter, expected in enumerate([(x, y), (-y, x), (-x, -y), (y, -x)]):
        rows = np.arange(count) % 4 == quarter
        np.testing.assert_array_equal(states[rows][..., 0], expected[0][rows])
        np.testing.assert_array_equal(states[rows][..., 1], expected[1][rows])


def test_samples_are_uniform_over_the_group() -> None:
    s0 = np.tile(np.array([1, 0, 0, 0], np.float32), (20000, 1))
    maps = group().sample(np.random.default_rng(0), s0).states
    determinant = np.linalg.det(maps.matrix[:, :2, :2])
    assert abs((determinant < 0).mean() - 0.5) < 0.02
    angle = np.arctan2(maps.matrix[:, 0, 1], maps.matrix[:, 0, 0])
    assert np.abs(np.histogram(angle, 8, (-np.pi, np.pi))[0] / 2500 - 1).max() < 0.1
    amounts = maps.offset[:, 0]
    assert -3 <= amounts.min() < -2.9
    assert 4.9 < amounts.max() <= 5
    quarter = Symmetries(Turn(states=(("x", "y"),), quarter=True))
    turned = group(quarter).sample(np.random.default_rng(0), s0).states(s0)[:, :2]
    found, counts = np.unique(turned + 0.0, axis=0, return_counts=True)
    np.testing.assert_array_equal(found, [[-1, 0], [0, -1], [0, 1], [1, 0]])
    assert np.abs(counts / 5000 - 1).max() < 0.1


@pytest.mark.parametrize(
    "symmetries", [Symmetries(turn=TURN), Symmetries(mirror=MIRROR), Symmetries(shifts=(SHIFT,))]
)
def test_a_group_leaves_other_variables_as_they_are(symmetries: Symmetries) -> None:
    data = trajectories()
    found = group(symmetries).sample(np.random.default_rng(0), data.states[:, 0])
    states = found.states(data.states)
    np.testing.assert_array_equal(states[..., 2], data.states[..., 2])
    if not symmetries.turn.states:
        changed = (states != data.states).any((0, 1))
        expected = [False, True, False, True] if symmetries.mirror.states else [True] + [False] * 3
        np.testing.assert_array_equal(changed, expected)


def test_the_moments_are_those_of_the_orbit() -> None:
    """Turned copies are evenly spaced: a rotated pair has mean zero and equal scales."""
    data = trajectories()
    data.states[..., 0] *= 5
    turned = SymmetryGroup(Symmetries(TURN, MIRROR), STATE, ACTION, GOAL)
    units = Normalization.from_trajectories(data, turned)
    np.testing.assert_allclose(units.state_mean[:2], 0.0, atol=1e-5)
    np.testing.assert_allclose(units.action_mean[:2], 0.0, atol=1e-5)
    radius = np.square(data.states[..., :2].astype(np.float64)).sum(-1).mean()
    np.testing.assert_allclose(units.state_scale[:2], np.sqrt(radius / 2), rtol=1e-5)
    assert units.delta_std[0] == pytest.approx(units.delta_std[1], rel=1e-5)
    plain = Normalization.from_trajectories(data)
    np.testing.assert_allclose(units.state_mean[2], plain.state_mean[2], rtol=1e-6)
    np.testing.assert_allclose(units.action_scale[2], plain.action_scale[2], rtol=1e-6)
    shifted = Normalization.from_trajectories(data, group(Symmetries(shifts=(SHIFT,))))
    assert shifted.state_mean[0] == pytest.approx(plain.state_mean[0] + 1.0, abs=0.5)


def test_the_canonical_frame_of_a_data_set() -> None:
    names = ("gain", "bx", "ax", "by", "ay", "vx", "vy")
    pairs = (("vx", "vy"), ("ax", "ay"), ("bx", "by"))
    turn = Turn(states=pairs, axis=(pairs[2], pairs[1]))
    states = np.random.default_rng(0).normal(size=(10, 4, 7)).astype(np.float32)
    none = np.zeros((10, 0), np.float32)
    facts = {"state": [{"name": name} for name in names], "symmetries": Symmetries(turn).to_json()}
    facts |= {"action": [{"name": "torque"}]}
    data = Trajectories(states, np.ones((10, 3, 1), np.float32), none, none, facts)
    units = Normalization.from_trajectories(data, SymmetryGroup.from_facts(facts))
    np.testing.assert_array_equal(units.turned_pairs, [[5, 6], [2, 4], [1, 3]])
    np.testing.assert_array_equal(units.axis, [[1, 3], [2, 4]])
    without = Normalization.from_trajectories(data)
    assert len(without.axis) == len(without.turned_pairs) == 0


def test_the_copies_do_not_depend_on_the_call() -> None:
    data = trajectories()
    first, second = (list(orbit_parts(data, group(), 25)) for _ in range(2))
    assert len(first) == 2 * COPIES
    assert sum(len(states) for states, _ in first) == COPIES * len(data)
    for (states, actions), (again, actions_again) in zip(first, second, strict=True):
        np.testing.assert_array_equal(states, again)
        np.testing.assert_array_equal(actions, actions_again)
