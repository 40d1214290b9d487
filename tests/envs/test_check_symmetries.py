"""The declared symmetries hold, exactly where noise can be transformed; wrong ones are named."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from study.common.arrays import Booleans, Floats
from study.common.contract import CheckFailed
from study.common.errors import BadInput
from study.common.seeds import Seeds, spawn
from study.data.transformations import SymmetryGroup
from study.envs import Episode, Mirror, Rollout, Shift, Simulator, Symmetries, Turn, simulators
from study.envs import pusher as pusher_module
from study.envs.check import check_simulator
from study.envs.check_symmetries import check_symmetries
from study.envs.noise import Noise
from study.envs.pusher import Pusher
from study.envs.registration import check_class
from study.envs.uav import Uav
from study.examples.cart import Cart, CartEpisode

CUSHION = "the ball reaches a cushion"


def group(simulator: type[Simulator]) -> SymmetryGroup:
    tables = (simulator.state, simulator.action, simulator.goal)
    return SymmetryGroup(simulator.symmetries, *([v.name for v in table] for table in tables))


def declared(simulator: type[Simulator], symmetries: Symmetries) -> Simulator:
    """The simulator with other symmetries, and a short horizon."""
    return type("Wrong", (simulator,), {"symmetries": symmetries})(horizon=40)


def without(simulator: type[Simulator], part: str, array: str, name: str) -> Symmetries:
    """The symmetries of a simulator, but that one forgets a variable."""
    symmetries = simulator.symmetries
    changed: Any = getattr(symmetries, part)
    kept = tuple(v for v in getattr(changed, array) if name not in (v, *v))
    return replace(symmetries, **{part: replace(changed, **{array: kept})})


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pusher", "uav", "cart"])
def test_the_declared_symmetries_hold(name: str) -> None:
    for check in check_symmetries(simulators[name]()):
        assert check.difference < 5e-4, check
        assert check.left_out <= check.scenarios // 10, check


def test_the_cushions_of_the_pusher_break_turns_that_are_no_quarter_turns() -> None:
    """Balls that roll to the edge of the table: the event is found, named, and left out."""
    turn = Pusher.symmetries.turn

    class Rolling(Pusher):
        symmetries = Symmetries(turn=turn)

        def rollout(self, s0: Floats, actions: Floats, seeds: Seeds | None = None) -> Rollout:
            # The ball of every eighth scenario moves outwards from the start.
            fast = s0.copy()
            outwards = s0[:, 8:10] / np.linalg.norm(s0[:, 8:10], axis=1, keepdims=True)
            fast[:, 10:12] += 2 * outwards * (np.abs(s0[:, 5:6]) < 0.15)
            rollout = super().rollout(fast, actions, seeds)
            rollout.states[:, 0] = s0
            return rollout

    checks = {check.name: check for check in check_symmetries(Rolling(horizon=30))}
    assert checks["turns by any angle"].left_out > checks["quarter turns"].left_out
    Rolling.symmetries = Symmetries(turn=replace(turn, broken_by=()))
    with pytest.raises(CheckFailed, match=f"'{CUSHION}' happens; name the event in turn.broken"):
        check_symmetries(Rolling(horizon=30))


WRONG = [
    (Pusher, "mirror", "actions", "lower_torque", r"mirror: 'gamma_rate' at step 1"),
    (Pusher, "mirror", "states", "theta_rate", r"mirror: 'theta_rate' at step 1"),
    (Pusher, "mirror", "states", "arm_y", r"mirror: 'arm_y' at step 1"),
    (Pusher, "mirror", "goal", "target_y", r"mirror: the distance to the target .* 'target_y'"),
    (Pusher, "turn", "states", "ball_x", r"quarter turns: 'ball_._rate' at step \d+ differs"),
    (Pusher, "turn", "goal", "target_x", r"quarter turns: the distance .*how the goal transforms"),
    (Uav, "mirror", "states", "wind_y", r"mirror: '.*' at step 1 differs"),
    (Uav, "mirror", "actions", "yaw_rate", r"mirror: '.*' at step 1 .* and the actions"),
    (Uav, "turn", "angles", "yaw", r"quarter turns: '.*' at step 1"),
    (Uav, "turn", "actions", "vx", r"quarter turns: '.*' at step 1"),
]


@pytest.mark.parametrize(("simulator", "part", "array", "name", "error"), WRONG)
def test_a_forgotten_variable_is_found(
    simulator: type[Simulator], part: str, array: str, name: str, error: str
) -> None:
    wrong = declared(simulator, without(simulator, part, array, name))
    wrong.horizon = 40 if simulator is Pusher else 4
    with pytest.raises(CheckFailed, match=error) as caught:
        check_symmetries(wrong)
    assert "\n" not in str(caught.value)


def test_a_height_that_is_shifted_is_found() -> None:
    up = Symmetries(shifts=(Shift(20.0, 300.0, states=("z",), goal=("target_z",)),))
    with pytest.raises(CheckFailed, match=r"shifts: '.*' at step \d+ differs by"):
        check_symmetries(declared(Uav, up))


class BiasedEpisode(CartEpisode):
    """The noise of every cart pushes to the right; the calm system is symmetric."""

    def step(self, actions: Floats) -> Floats:
        return super().step(actions + np.float32(0.2 * bool(self.generators)))


class Biased(Cart):
    def start_episode(
        self, s0: Floats, seeds: Seeds | None = None, noise_steps: int = 1
    ) -> Episode:
        return BiasedEpisode(s0, seeds, self.control_step)


def test_noise_without_the_symmetry_is_found() -> None:
    with pytest.raises(CheckFailed, match=r"mirror: '[xv]' at step .* the noise does not have"):
        check_simulator(Biased)


def test_the_check_of_a_simulator_checks_its_symmetries() -> None:
    wrong = type("Wrong", (Cart,), {"symmetries": Symmetries(mirror=Mirror(states=("x", "v")))})
    with pytest.raises(CheckFailed, match=r"Wrong.symmetries: mirror: '[xv]' at step 1 differs"):
        check_simulator(wrong)


def test_an_event_that_does_not_exist() -> None:
    turn = replace(Pusher.symmetries.turn, broken_by=("the ball explodes",))
    with pytest.raises(CheckFailed, match=f"the event 'the ball explodes', .*'{CUSHION}'"):
        check_symmetries(declared(Pusher, Symmetries(turn=turn)))


class Chaotic(Cart):
    """Rounding of the start decides about every rollout."""

    def rollout(self, s0: Floats, actions: Floats, seeds: Seeds | None = None) -> Rollout:
        rollout = super().rollout(s0, actions, seeds)
        rollout.states[:, 1:, 0] += np.sin(1e8 * s0[:, :1])
        return rollout


def test_nothing_can_be_checked_where_rounding_decides() -> None:
    with pytest.raises(CheckFailed, match="all 128 scenarios are left out, since rounding"):
        check_symmetries(Chaotic())


@pytest.mark.parametrize(
    ("symmetries", "error"),
    [
        ((("x", "y"),), "symmetries: got .*; give study.envs.Symmetries"),
        (
            Symmetries(mirror=Mirror(states=("x", "w"))),
            "symmetries: mirror.states has no variable 'w'",
        ),
        (
            Symmetries(turn=Turn(goal=(("target", "y"),))),
            "symmetries: turn.goal has no variable 'y'",
        ),
        (
            Symmetries(mirror=Mirror(actions=("force", "force"))),
            "mirror.actions names 'force' twice; name it once",
        ),
        (
            Symmetries(turn=Turn(states=(("x", "v"),), angles=("x",))),
            "turn.states names 'x' twice; name it once",
        ),
        (Symmetries(shifts=(Shift(1.0, 1.0, ("x",)),)), "a shift of x is between 1.0 and 1.0"),
    ],
)
def test_names_are_checked_when_a_class_registers(symmetries: Any, error: str) -> None:
    with pytest.raises(BadInput, match=error):
        check_class(type("Wrong", (Cart,), {"symmetries": symmetries}))


def test_the_mirror_and_quarter_turns_of_the_pusher_are_exact_with_its_noise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Quarter turns with the same torque noise, the mirror with the negated noise; to the bit."""
    simulator, count = Pusher(), 64
    seeds = spawn(3, count)
    scenarios = simulator.sample_scenarios(seeds)
    actions = simulator.plan(scenarios, seeds)
    noisy = simulator.rollout(scenarios.s0, actions, seeds).states
    no_shift = np.zeros((count, 0))

    def difference(angle: np.ndarray, mirrored: Booleans) -> np.ndarray:
        maps = group(Pusher).transformations(scenarios.s0, angle, mirrored, no_shift)
        s0, expected = maps.states(scenarios.s0), maps.states(noisy)
        found = simulator.rollout(s0, maps.actions(actions), seeds).states
        return np.abs(found - expected).max(axis=(1, 2))

    quarters = np.arange(count) % 4 * (np.pi / 2)
    assert (difference(quarters, np.zeros(count, bool)) < 1e-6).all()
    any_angle = difference(np.linspace(-3, 3, count), np.zeros(count, bool))
    meets = simulator.events(noisy)[CUSHION]
    assert (any_angle[~meets] < 1e-3).mean() > 0.95
    assert (difference(np.zeros(count), np.ones(count, bool)) > 0.01).all()

    class Negated(Noise):
        def step(self) -> np.ndarray:
            return -super().step()

    monkeypatch.setattr(pusher_module, "Noise", Negated)
    assert (difference(np.zeros(count), np.ones(count, bool)) == 0).all()
