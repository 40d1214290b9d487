"""The Pusher: its physics, its plans, its contract."""

import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from study.envs.pusher import BEHIND, Pusher
from study.envs.pusher_policy import CONTACT, LINK
from study.envs.simulator import Doubles, Floats, Rollout, Scenarios, simulators
from study.seeds import Seeds, spawn

COUNT = 100
BALL_MASS = 0.04
INERTIA = 7 / 5 * BALL_MASS  # of a rolling ball, against a push


@pytest.fixture(scope="module")
def pusher() -> Pusher:
    return Pusher()


@pytest.fixture(scope="module")
def seeds() -> Seeds:
    return spawn(7, COUNT)


@pytest.fixture(scope="module")
def scenarios(pusher: Pusher, seeds: Seeds) -> Scenarios:
    return pusher.draw(seeds)


@pytest.fixture(scope="module")
def actions(pusher: Pusher, scenarios: Scenarios, seeds: Seeds) -> Floats:
    return pusher.plan(scenarios, seeds)


@pytest.fixture(scope="module")
def noisy(pusher: Pusher, scenarios: Scenarios, actions: Floats, seeds: Seeds) -> Rollout:
    return pusher.rollout(scenarios.s0, actions, seeds)


@pytest.fixture(scope="module")
def nominal(pusher: Pusher, scenarios: Scenarios, actions: Floats, seeds: Seeds) -> Rollout:
    return pusher.rollout(scenarios.s0, actions, seeds, noise=False)


def make_state(
    angles: tuple[float, float] = (0.0, 1.0),
    rates: tuple[float, float] = (0.0, 0.0),
    ball: tuple[float, float] = (-0.22, -0.22),  # out of reach
    velocity: tuple[float, float] = (0.0, 0.0),
) -> Floats:
    """One state [1, 12]."""
    theta, gamma = angles
    end = LINK * np.array([np.cos(theta) + np.cos(theta + gamma), 0.0])
    end[1] = LINK * (np.sin(theta) + np.sin(theta + gamma))
    upper = (np.cos(theta), np.sin(theta), rates[0])
    lower = (np.cos(gamma), np.sin(gamma), rates[1])
    return np.array([[*end, *upper, *lower, *ball, *velocity]], np.float32)


def coast(simulator: Pusher, s0: Floats, torque: tuple[float, float] = (0.0, 0.0)) -> Doubles:
    """States [T+1, 12] of one noise-free trajectory under a constant torque."""
    actions = np.full((1, simulator.horizon, 2), torque, np.float32)
    return simulator.rollout(s0, actions, spawn(0, 1), noise=False).states[0].astype(np.float64)


def angular_momentum(simulator: Pusher, states: Floats) -> Doubles:
    """[T+1] kg·m²/s about the shoulder: of the arm, by MuJoCo's mass matrix, and of the ball."""
    data, along = mujoco.MjData(simulator.model), np.zeros(4)
    momenta = []
    for position, state in zip(simulator.configuration(states), states, strict=True):
        data.qpos[:] = position
        mujoco.mj_forward(simulator.model, data)
        mujoco.mj_mulM(simulator.model, data, along, np.float64(state[[4, 7, 10, 11]]))
        momenta.append(along[0] + position[2] * along[3] - position[3] * along[2])
    return np.array(momenta)


def frictionless(horizon: int, timestep: float = 0.0005) -> Pusher:
    """A Pusher without damping, in fine physics steps."""
    simulator = Pusher(horizon)
    simulator.model.dof_damping[:] = 0
    simulator.model.opt.timestep = timestep
    simulator.substeps = round(simulator.control_step / timestep)
    return simulator


# The contract


def test_it_is_registered_and_its_tables_fit_its_arrays(
    scenarios: Scenarios, actions: Floats, noisy: Rollout
) -> None:
    assert simulators["pusher"] is Pusher
    assert noisy.states.shape == (COUNT, 121, len(Pusher.state)) == (COUNT, 121, 12)
    assert actions.shape == (COUNT, 120, len(Pusher.action))
    assert scenarios.task.shape == (COUNT, len(Pusher.task))
    assert noisy.hidden.shape == (COUNT, 0)
    for array in (scenarios.s0, scenarios.task, actions, noisy.states, noisy.hidden):
        assert array.dtype == np.float32
    names = [v.name for table in (Pusher.state, Pusher.action, Pusher.task) for v in table]
    assert len(set(names)) == len(names)


def test_everything_stays_within_its_bounds(
    scenarios: Scenarios, actions: Floats, noisy: Rollout
) -> None:
    tables = (Pusher.state, Pusher.action, Pusher.task)
    for table, array in zip(tables, (noisy.states, actions, scenarios.task), strict=True):
        low, high = np.array([(v.low, v.high) for v in table]).T
        assert (array >= low - 1e-6).all()
        assert (array <= high + 1e-6).all()


def test_docstring_states_the_numbers_of_the_code(pusher: Pusher) -> None:
    text = " ".join((Pusher.__doc__ or "").split())
    tables = (Pusher.state, Pusher.action, Pusher.task, Pusher.start, Pusher.conditions)
    rows = [v for table in tables for v in table]
    for v in rows:
        assert f"| {v.name} | {v.unit} | {v.meaning} | {v.low:g} | {v.high:g} |" in text
    written = re.findall(r"\| (\w+) \| \S+ \| [^|]+ \| (?:-|inf|\d)", text)
    assert written == [v.name for v in rows]

    model = pusher.model
    ball, peg = model.geom("ball"), model.geom("peg")
    shoulder, slide = model.joint("shoulder"), model.joint("ball_x")
    for statement in (
        f"standard deviation {Pusher.torque_noise:g} N·m",
        f"{Pusher.default_horizon} control steps of {Pusher.control_step:g} s",
        f"within {Pusher.radius:g} m of the target",
        f"links of {LINK:g} m",
        f"peg (radius {peg.size[0]:g} m)",
        f"(radius {ball.size[0]:g} m, {model.body('ball').mass[0]:g} kg)",
        f"viscous damping of {slide.damping[0]:g} N·s/m",
        f"comes to ±{slide.range[1]:g} m",
        f"armature {shoulder.armature[0]:g} kg·m² and damping {shoulder.damping[0]:g} N·m·s",
    ):
        assert statement in text
    assert pusher.substeps == 2
    assert ball.size[0] + peg.size[0] == pytest.approx(CONTACT)


@pytest.mark.parametrize("horizon", [1, 7, 200])
def test_any_horizon(horizon: int, seeds: Seeds) -> None:
    simulator = Pusher(horizon)
    some = simulator.draw(seeds[:3])
    actions = simulator.plan(some, seeds[:3])
    states = simulator.rollout(some.s0, actions, seeds[:3]).states
    assert actions.shape == (3, horizon, 2)
    assert states.shape == (3, horizon + 1, 12)
    assert np.isfinite(states).all()


def test_a_longer_rollout_begins_like_a_shorter_one(
    pusher: Pusher, scenarios: Scenarios, actions: Floats, noisy: Rollout, seeds: Seeds
) -> None:
    short = pusher.rollout(scenarios.s0[:9], actions[:9, :31], seeds[:9]).states
    np.testing.assert_array_equal(short, noisy.states[:9, :32])


# Seeds


@pytest.mark.parametrize(
    ("rows", "threads"),
    [
        (np.arange(1), 1),
        (np.arange(5, 22), 1),
        (np.arange(COUNT)[::-1], 1),
        (np.arange(COUNT), 2),
        (np.random.default_rng(0).permutation(COUNT)[:37], 3),
    ],
    ids=["alone", "17", "reversed", "2 threads", "3 threads, shuffled"],
)
def test_a_trajectory_depends_on_its_own_seed_alone(
    rows: np.ndarray,
    threads: int,
    scenarios: Scenarios,
    actions: Floats,
    noisy: Rollout,
    seeds: Seeds,
) -> None:
    simulator = Pusher(threads=threads)
    drawn = simulator.draw(seeds[rows])
    np.testing.assert_array_equal(drawn.s0, scenarios.s0[rows])
    np.testing.assert_array_equal(drawn.task, scenarios.task[rows])
    np.testing.assert_array_equal(simulator.plan(drawn, seeds[rows]), actions[rows])
    again = simulator.rollout(drawn.s0, actions[rows], seeds[rows])
    np.testing.assert_array_equal(again.states, noisy.states[rows])


def test_more_trajectories_than_are_simulated_at_a_time(
    pusher: Pusher, scenarios: Scenarios, actions: Floats, noisy: Rollout, seeds: Seeds
) -> None:
    many = np.arange(Pusher._chunk + 30) % COUNT
    states = pusher.rollout(scenarios.s0[many], actions[many, :10], seeds[many]).states
    np.testing.assert_array_equal(states, noisy.states[many, :11])


def test_noise_differs_between_seeds_and_is_absent_when_turned_off(
    pusher: Pusher, scenarios: Scenarios, actions: Floats, nominal: Rollout, noisy: Rollout
) -> None:
    other = spawn(8, COUNT)
    silent = pusher.rollout(scenarios.s0, actions, other, noise=False)
    np.testing.assert_array_equal(silent.states, nominal.states)
    different = pusher.rollout(scenarios.s0, actions, other).states[:, -1, 8:10]
    assert (different != noisy.states[:, -1, 8:10]).any(axis=1).all()


def test_noise_is_a_gaussian_torque_on_each_joint_at_each_step() -> None:
    """Without contact or damping the joints' momenta are the sum of the torques."""
    simulator = frictionless(1)
    count = 4000
    s0 = np.repeat(make_state(angles=(0.0, np.pi / 2)), count, axis=0)
    end = simulator.rollout(s0, np.zeros((count, 1, 2), np.float32), spawn(1, count)).states[:, 1]
    data = mujoco.MjData(simulator.model)
    matrix: Doubles = np.zeros((2, 4))
    data.qpos[:] = simulator.configuration(s0[0])
    mujoco.mj_forward(simulator.model, data)
    for row in range(2):
        unit: Doubles = np.zeros(4)
        unit[row] = 1.0
        mujoco.mj_mulM(simulator.model, data, matrix[row], unit)
    torque: Doubles = end[:, [4, 7]].astype(np.float64) @ matrix[:, :2] / simulator.control_step
    assert torque.std(axis=0) == pytest.approx(Pusher.torque_noise, rel=0.05)
    assert np.abs(torque.mean(axis=0)).max() < 4 * Pusher.torque_noise / np.sqrt(count)
    assert abs(np.corrcoef(torque[:, 0], torque[:, 1])[0, 1]) < 0.07


# State


def test_rollout_begins_at_s0_exactly(
    scenarios: Scenarios, actions: Floats, noisy: Rollout, pusher: Pusher, seeds: Seeds
) -> None:
    np.testing.assert_array_equal(noisy.states[:, 0], scenarios.s0)
    middle = noisy.states[:, 60]
    resumed = pusher.rollout(middle, actions[:, 60:], seeds).states
    np.testing.assert_array_equal(resumed[:, 0], middle)


def test_a_trajectory_can_be_resumed_from_any_state(
    nominal: Rollout, actions: Floats, pusher: Pusher, seeds: Seeds
) -> None:
    resumed = pusher.rollout(nominal.states[:, 60], actions[:, 60:], seeds, noise=False).states
    error = np.abs(resumed[:, :4] - nominal.states[:, 60:64]).max()
    assert error < 1e-4  # float32 rounding of the state, grown over three steps


def test_arm_end_is_where_mujoco_has_it(pusher: Pusher, noisy: Rollout) -> None:
    data = mujoco.MjData(pusher.scene())
    states = noisy.states[::20, ::30].reshape(-1, 12)
    for state, position in zip(states, pusher.configuration(states), strict=True):
        data.qpos[:] = position
        mujoco.mj_kinematics(pusher.scene(), data)
        np.testing.assert_allclose(data.site("arm_end").xpos[:2], state[:2], atol=1e-6)
        np.testing.assert_allclose(data.body("ball").xpos, pusher.position(state), atol=1e-6)


def test_rates_are_the_derivatives_of_positions(nominal: Rollout) -> None:
    states = nominal.states.astype(np.float64)
    for cos, rate in ((2, 4), (5, 7)):
        angle = np.unwrap(np.arctan2(states[..., cos + 1], states[..., cos]), axis=1)
        step = np.diff(angle, axis=1) / Pusher.control_step
        between = (states[:, 1:, rate] + states[:, :-1, rate]) / 2
        assert np.corrcoef(step.ravel(), between.ravel())[0, 1] > 0.99
        assert np.abs(step - between).mean() < 0.1
    step = np.diff(states[..., 8:10], axis=1) / Pusher.control_step
    assert np.corrcoef(step.ravel(), states[:, 1:, 10:].ravel())[0, 1] > 0.99
    assert np.abs(step - states[:, 1:, 10:]).mean() < 0.01


# Physics


def test_ball_slows_as_viscous_damping_says(pusher: Pusher) -> None:
    states = coast(pusher, make_state(ball=(-0.15, 0.1), velocity=(0.3, 0.0)))
    time = np.arange(121) * Pusher.control_step
    expected = 0.3 * np.exp(-0.12 / INERTIA * time)
    np.testing.assert_allclose(states[:, 10], expected, atol=0.002)
    assert (np.diff(states[:, 10]) < 0).all()


@pytest.mark.parametrize("direction", [0.0, 0.7, 2.5, 4.0])
def test_ball_stays_on_the_table_however_hard_it_is_pushed(direction: float) -> None:
    simulator = frictionless(120, timestep=0.01)
    heading = (2 * np.cos(direction), 2 * np.sin(direction))
    ball = coast(simulator, make_state(ball=(0.0, -0.2), velocity=heading))[:, 8:10]
    assert np.abs(ball).max() > 0.235  # it did reach a cushion
    assert np.abs(ball).max() < 0.26


def test_the_arm_pushes_the_ball_and_the_ball_pushes_the_arm() -> None:
    """Angular momentum about the shoulder is conserved, and it passes both ways."""
    simulator = frictionless(20)  # too short for the ball to reach a cushion
    x, y = LINK * (1 + np.cos(1.0)), LINK * np.sin(1.0)
    heading = np.array([-y, x]) / np.hypot(x, y)  # the arm end's, as the shoulder turns
    ball_x, ball_y = np.array([x, y]) + 0.04 * heading

    struck = coast(simulator, make_state((0, 1), (3.0, 0.0), (ball_x, ball_y)))
    assert np.hypot(struck[-1, 10], struck[-1, 11]) > 0.1
    assert struck[-1, 4] < 3.0 - 0.3
    momentum = angular_momentum(simulator, struck.astype(np.float32))
    np.testing.assert_allclose(momentum, momentum[0], rtol=2e-3)

    rolled = coast(simulator, make_state((0, 1), (0, 0), (ball_x, ball_y), tuple(-0.4 * heading)))
    assert rolled[-1, 4] < -0.5
    assert np.hypot(rolled[-1, 10], rolled[-1, 11]) < 0.35
    momentum = angular_momentum(simulator, rolled.astype(np.float32))
    np.testing.assert_allclose(momentum, momentum[0], rtol=2e-3)


def test_only_the_peg_touches_the_ball(pusher: Pusher) -> None:
    upper_arm_across = make_state(angles=(0.0, 1.5), rates=(0, 0), ball=(0.05, 0.03))
    states = coast(pusher, upper_arm_across, torque=(0.01, 0.0))
    theta = np.arctan2(states[:, 3], states[:, 2])
    assert theta.max() > np.arctan2(0.03, 0.05)  # the upper arm has swept over the ball
    np.testing.assert_array_equal(states[:, 8:10], np.tile(states[0, 8:10], (121, 1)))


def test_energy_is_conserved_to_first_order_of_the_physics_step() -> None:
    drifts = []
    for timestep in (0.001, 0.0005):
        simulator = frictionless(50, timestep)
        simulator.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
        data, energies = mujoco.MjData(simulator.model), []
        for state in coast(simulator, make_state((0.3, 1.2), (4.0, -3.0))).astype(np.float32)[::5]:
            data.qpos[:] = simulator.configuration(state)
            data.qvel[:] = state[[4, 7, 10, 11]]
            mujoco.mj_forward(simulator.model, data)
            mujoco.mj_energyVel(simulator.model, data)
            energies.append(data.energy[1])
        drifts.append(np.abs(np.array(energies) / energies[0] - 1).max())
    assert drifts[0] < 0.05
    assert drifts[0] / drifts[1] == pytest.approx(2.0, abs=0.3)


def test_torques_beyond_the_bounds_count_as_the_bounds(pusher: Pusher) -> None:
    bound = Pusher.action[0].high
    np.testing.assert_array_equal(
        coast(pusher, make_state(), (9.0, -9.0)), coast(pusher, make_state(), (bound, -bound))
    )


# Scenarios, plans and outcomes


def test_scenarios_meet_their_conditions_and_vary(scenarios: Scenarios) -> None:
    s0, task = scenarios.s0.astype(np.float64), scenarios.task.astype(np.float64)
    arm, ball = s0[:, :2], s0[:, 8:10]
    travel = np.linalg.norm(task - ball, axis=1)
    behind = ball - BEHIND * (task - ball) / travel[:, None]
    values = {
        "clearance": np.linalg.norm(arm - ball, axis=1),
        "travel": travel,
        "behind": np.linalg.norm(behind, axis=1),
    }
    for condition in Pusher.conditions:
        assert (values[condition.name] >= condition.low - 1e-6).all()
        assert (values[condition.name] <= condition.high + 1e-6).all()
    assert (s0[:, [4, 7, 10, 11]] == 0).all()
    for varied in (arm, ball, task):
        assert (varied.std(axis=0) > 0.04).all()


def test_plan_reaches_the_target_in_most_nominal_scenarios(
    pusher: Pusher, scenarios: Scenarios, nominal: Rollout
) -> None:
    assert pusher.outcome(nominal.states[:, 1:], scenarios.task).mean() >= 0.8
    at_rest = np.repeat(scenarios.s0[:, None], 120, axis=1)
    assert not pusher.outcome(at_rest, scenarios.task).any()


def test_plans_of_one_scenario_vary_with_the_seed(pusher: Pusher, scenarios: Scenarios) -> None:
    same = Scenarios(*(np.repeat(a[:1], 8, axis=0) for a in (scenarios.s0, scenarios.task)))
    plans = pusher.plan(same, spawn(9, 8))
    assert (plans.std(axis=0).mean(axis=0) > 0.001).all()


def test_noise_makes_the_outcome_uncertain(
    pusher: Pusher, scenarios: Scenarios, actions: Floats
) -> None:
    """Base rate 0.4–0.6, and most scenarios neither certain nor hopeless (loosely: 20 rollouts)."""
    rollouts = 20
    s0, planned, task = (
        np.repeat(a, rollouts, axis=0) for a in (scenarios.s0, actions, scenarios.task)
    )
    states = pusher.rollout(s0, planned, spawn(10, COUNT * rollouts)).states
    probability = pusher.outcome(states[:, 1:], task).reshape(COUNT, rollouts).mean(axis=1)
    assert 0.35 < probability.mean() < 0.65
    assert ((probability > 0.1) & (probability < 0.9)).mean() >= 0.5


def test_outcome_is_the_ball_within_the_radius_at_any_step(
    pusher: Pusher, scenarios: Scenarios
) -> None:
    states = np.repeat(make_state(ball=(0.1, 0.1)), 5, axis=0)
    reached = np.array([0.1 + 0.9 * Pusher.radius, 0.1], np.float32)
    beyond = np.array([0.1 + 1.1 * Pusher.radius, 0.1], np.float32)
    assert pusher.outcome(states, reached)
    assert not pusher.outcome(states, beyond)
    passing = states.copy()
    passing[2, 8] += 0.2 * Pusher.radius
    assert pusher.outcome(passing, beyond)
    passing[2, 8] = np.nan
    assert not pusher.outcome(passing, beyond)

    fan = np.broadcast_to(scenarios.s0[:, None, None], (COUNT, 3, 4, 12))
    assert pusher.outcome(fan, scenarios.task[:, None]).shape == (COUNT, 3)
    there = replace(scenarios, task=scenarios.s0[:, 8:10])
    assert pusher.outcome(fan, there.task[:, None]).all()
    height = pusher.model.geom("ball").size[0]
    np.testing.assert_allclose(pusher.position(fan)[..., 2], height, rtol=1e-6)
    np.testing.assert_allclose(pusher.target(scenarios.task)[:, 2], height, rtol=1e-6)
