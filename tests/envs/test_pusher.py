"""The Pusher: its noise, physics, scenarios and plans."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from study.common.arrays import Doubles, Floats
from study.common.seeds import Seeds, spawn
from study.envs.pusher import BEHIND, Pusher
from study.envs.pusher_policy import CONTACT, LINK
from study.envs.simulator import Rollout, Scenarios

COUNT = 100
BALL_MASS = 0.04
INERTIA = 7 / 5 * BALL_MASS  # of a rolling ball


@pytest.fixture(scope="module")
def pusher() -> Pusher:
    return Pusher()


@pytest.fixture(scope="module")
def seeds() -> Seeds:
    return spawn(7, COUNT)


@pytest.fixture(scope="module")
def scenarios(pusher: Pusher, seeds: Seeds) -> Scenarios:
    return pusher.sample_scenarios(seeds)


@pytest.fixture(scope="module")
def actions(pusher: Pusher, scenarios: Scenarios, seeds: Seeds) -> Floats:
    return pusher.plan(scenarios, seeds)


@pytest.fixture(scope="module")
def noisy(pusher: Pusher, scenarios: Scenarios, actions: Floats, seeds: Seeds) -> Rollout:
    return pusher.rollout(scenarios.s0, actions, seeds)


@pytest.fixture(scope="module")
def nominal(pusher: Pusher, scenarios: Scenarios, actions: Floats) -> Rollout:
    return pusher.rollout(scenarios.s0, actions)


def make_state(
    angles: tuple[float, float] = (0.0, 1.0),
    rates: tuple[float, float] = (0.0, 0.0),
    ball: tuple[float, float] = (-0.22, -0.22),  # Out of reach.
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
    return simulator.rollout(s0, actions).states[0].astype(np.float64)


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
    for model in (simulator.model, simulator.swarm):
        model.dof_damping[:] = 0
        model.opt.timestep = timestep
    return simulator


def test_constants_of_the_policy_are_those_of_the_model(pusher: Pusher) -> None:
    model = pusher.model
    peg, arm = model.geom("peg"), model.geom("upper_arm")
    assert model.geom("ball").size[0] + peg.size[0] == pytest.approx(CONTACT)
    assert peg.size[0] == arm.size[0]
    assert 2 * arm.size[1] == pytest.approx(LINK)
    inertia = model.body("ball").mass[0] + model.joint("ball_x").armature[0]
    assert inertia == pytest.approx(INERTIA)
    assert pusher.control_step / model.opt.timestep == pytest.approx(4)


# Noise


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


def test_a_trajectory_can_be_resumed_from_any_state(
    nominal: Rollout, actions: Floats, pusher: Pusher
) -> None:
    resumed = pusher.rollout(nominal.states[:, 60], actions[:, 60:]).states
    error = np.abs(resumed[:, :4] - nominal.states[:, 60:64]).max()
    assert error < 1e-4  # Rounding of the state to float32, grown over three steps.


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
    assert np.abs(ball).max() > 0.235  # It reached a cushion.
    assert np.abs(ball).max() < 0.26


def test_the_arm_pushes_the_ball_and_the_ball_pushes_the_arm() -> None:
    """Angular momentum about the shoulder is conserved, and passes both ways."""
    simulator = frictionless(20)  # Too short for the ball to reach a cushion.
    x, y = LINK * (1 + np.cos(1.0)), LINK * np.sin(1.0)
    heading = np.array([-y, x]) / np.hypot(x, y)  # Of the arm end, as the shoulder rotates.
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


@pytest.mark.parametrize(
    ("aside", "event"),
    [
        (0.0, "the ball is hit squarely"),
        (0.9, "the ball is grazed"),
        (1.2, "the ball is missed"),
    ],
)
def test_events_say_how_the_ball_is_hit(pusher: Pusher, aside: float, event: str) -> None:
    """The ball lies `aside` of the peg's path, in units of the distance at contact."""
    out = LINK * (1 + np.cos(1.0)), LINK * np.sin(1.0)
    reach, bearing = float(np.hypot(*out)), float(np.arctan2(out[1], out[0]))
    distance, ahead = reach + aside * CONTACT, bearing + 0.5
    ball = (distance * np.cos(ahead), distance * np.sin(ahead))
    states = pusher.rollout(
        make_state((0, 1), (3.0, 0.0), ball), np.zeros((1, 30, 2), np.float32)
    ).states
    happened = {name for name, did in pusher.events(states).items() if did[0]}
    assert happened == {event}


def test_only_the_peg_touches_the_ball(pusher: Pusher) -> None:
    upper_arm_across = make_state(angles=(0.0, 1.5), rates=(0, 0), ball=(0.05, 0.03))
    states = coast(pusher, upper_arm_across, torque=(0.01, 0.0))
    theta = np.arctan2(states[:, 3], states[:, 2])
    assert theta.max() > np.arctan2(0.03, 0.05)  # The upper arm has passed above the ball.
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


def test_the_physics_step_is_fine_enough(
    scenarios: Scenarios, actions: Floats, noisy: Rollout, seeds: Seeds
) -> None:
    """With a quarter of the step and the same noise, the ball ends at the same place in most."""
    fine = Pusher()
    for model in (fine.model, fine.swarm):
        model.opt.timestep /= 4
    ends = fine.rollout(scenarios.s0, actions, seeds).states[:, -1, 8:10]
    apart = np.linalg.norm(ends - noisy.states[:, -1, 8:10], axis=1)
    moved = np.linalg.norm(noisy.states[:, -1, 8:10] - scenarios.s0[:, 8:10], axis=1)
    assert np.median(apart) < 0.1 * np.median(moved)
    assert np.median(apart) < 0.01


# Scenarios, plans and outcomes


def test_scenarios_meet_their_conditions_and_vary(scenarios: Scenarios) -> None:
    s0, goal = scenarios.s0.astype(np.float64), scenarios.goal.astype(np.float64)
    arm, ball = s0[:, :2], s0[:, 8:10]
    travel = np.linalg.norm(goal - ball, axis=1)
    behind = ball - BEHIND * (goal - ball) / travel[:, None]
    values = {
        "clearance": np.linalg.norm(arm - ball, axis=1),
        "travel": travel,
        "behind": np.linalg.norm(behind, axis=1),
    }
    for condition in Pusher.scenario_conditions:
        assert (values[condition.name] >= condition.low - 1e-6).all()
        assert (values[condition.name] <= condition.high + 1e-6).all()
    assert (s0[:, [4, 7, 10, 11]] == 0).all()
    for varied in (arm, ball, goal):
        assert (varied.std(axis=0) > 0.04).all()


def test_plan_reaches_the_target_in_most_nominal_scenarios(
    pusher: Pusher, scenarios: Scenarios, nominal: Rollout
) -> None:
    assert pusher.outcome(nominal.states[:, 1:], scenarios.goal).mean() >= 0.8
    at_rest = np.repeat(scenarios.s0[:, None], 120, axis=1)
    assert not pusher.outcome(at_rest, scenarios.goal).any()


def test_plans_of_one_scenario_vary_with_the_seed(pusher: Pusher, scenarios: Scenarios) -> None:
    same = Scenarios(*(np.repeat(a[:1], 8, axis=0) for a in (scenarios.s0, scenarios.goal)))
    plans = pusher.plan(same, spawn(9, 8))
    assert (plans.std(axis=0).mean(axis=0) > 0.001).all()


def test_noise_makes_the_outcome_uncertain(
    pusher: Pusher, scenarios: Scenarios, actions: Floats
) -> None:
    """Base rate 0.4–0.6, and most scenarios neither certain nor hopeless (loosely: 20 rollouts)."""
    rollouts = 20
    s0, planned, goal = (
        np.repeat(a, rollouts, axis=0) for a in (scenarios.s0, actions, scenarios.goal)
    )
    states = pusher.rollout(s0, planned, spawn(10, COUNT * rollouts)).states
    probability = pusher.outcome(states[:, 1:], goal).reshape(COUNT, rollouts).mean(axis=1)
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
    assert pusher.outcome(fan, scenarios.goal[:, None]).shape == (COUNT, 3)
    there = replace(scenarios, goal=scenarios.s0[:, 8:10])
    assert pusher.outcome(fan, there.goal[:, None]).all()
    height = pusher.model.geom("ball").size[0]
    np.testing.assert_allclose(pusher.position(fan)[..., 2], height, rtol=1e-6)
    np.testing.assert_allclose(pusher.target(scenarios.goal)[:, 2], height, rtol=1e-6)
