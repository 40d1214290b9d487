"""The UAV: its noise, scenarios, plans, and the ends of its flights."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from study.common.seeds import spawn
from study.envs import simulators, uav, uav_pilot
from study.envs import uav_physics as physics
from study.envs.uav_physics import SWARM
from tests.helpers.uav import fly, still

# Noise and scenarios


def test_payloads_and_gusts_differ_between_seeds() -> None:
    simulator = simulators["uav"](horizon=5)
    s0, actions, _ = fly(simulator, 1)
    many = simulator.rollout(s0.repeat(400, 0), actions.repeat(400, 0), spawn(9, 400))
    low, high = simulator.unobserved[0].low, simulator.unobserved[0].high
    assert many.unobserved.min() >= low
    assert many.unobserved.max() <= high
    # A uniform's mean and deviation, within four standard errors.
    width = high - low
    assert many.unobserved.mean() == pytest.approx(
        low + width / 2, abs=4 * width / np.sqrt(12 * 400)
    )
    assert many.unobserved.std() == pytest.approx(width / np.sqrt(12), rel=0.1)
    assert (many.states[:, 1:, 12:15].std(axis=0) > 0).all()


def test_the_nominal_system_has_the_mean_payload_and_no_gust() -> None:
    simulator = simulators["uav"](horizon=6)
    s0, actions, _ = fly(simulator, 4)
    nominal = simulator.rollout(s0, actions)
    assert (nominal.unobserved == np.float32(physics.MEAN_PAYLOAD)).all()
    assert (nominal.states[..., 12:15] == s0[:, None, 12:15]).all()


def test_scenarios_lie_within_their_bounds() -> None:
    simulator = simulators["uav"]()
    scenarios = simulator.sample_scenarios(spawn(2, 300))
    bounds = {v.name: v for v in uav.SCENARIO_VARIABLES}
    for column, variable in enumerate(simulator.state):
        sampled = scenarios.s0[:, column]
        assert (sampled >= variable.low).all()
        assert (sampled <= variable.high).all()
        if variable.name in bounds:
            v = bounds[variable.name]
            assert sampled.min() == pytest.approx(v.low, abs=0.05 * (v.high - v.low))
            assert sampled.max() == pytest.approx(v.high, abs=0.05 * (v.high - v.low))
    away = scenarios.goal - scenarios.s0[:, :3]
    pace = np.linalg.norm(away[:, :2], axis=1) / (simulator.horizon * simulator.control_step)
    assert pace.min() >= bounds["pace"].low
    assert pace.max() <= bounds["pace"].high + 1e-4


# Ground and battery


def test_the_ground_ends_a_flight_in_a_defined_state() -> None:
    simulator = simulators["uav"](horizon=20)
    s0 = still(2, height=4.0, yaw=5.0, wind_x=5.0, vx=3.0)
    actions = np.tile(np.array([4.0, 0.0, -3.0, 0.5], np.float32), (2, 20, 1))
    states = simulator.rollout(s0, actions, spawn(0, 2)).states
    landed = states[0, states[0, :, 2] == 0]
    assert 5 < len(landed) < 20
    assert (landed[:, 3:8] == 0).all()
    assert (landed[:, 9:12] == 0).all()
    assert (landed[:, [0, 1, 8, 16]] == landed[0, [0, 1, 8, 16]]).all()
    assert 5.0 < landed[0, 8] < 8.0  # The initial heading, not wrapped.
    assert (np.diff(landed[:, 12]) != 0).all()  # The weather goes on.
    assert states[:, :, 2].min() == 0


def test_an_empty_battery_lets_it_fall() -> None:
    simulator = simulators["uav"](horizon=40)
    s0 = still(SWARM, height=40.0, battery=2.0)
    actions = np.tile(np.array([6.0, -3.0, 0.5, 1.0], np.float32), (SWARM, 40, 1))
    states = simulator.rollout(s0, actions, spawn(0, SWARM)).states
    assert (states[:, -1, 16] == 0).all()
    assert (states[:, -1, 2] == 0).all()
    assert (states[:, :, 5].min(axis=1) < -15).all()
    assert np.isfinite(states).all()


def test_violent_commands_stay_finite_and_upright() -> None:
    simulator = simulators["uav"]()
    generator = np.random.default_rng(0)
    s0 = simulator.sample_scenarios(spawn(4, 64)).s0
    bounds = np.array([(v.low, v.high) for v in simulator.action]).T
    actions = generator.uniform(bounds[0], bounds[1], (64, 60, 4)).astype(np.float32)
    states = simulator.rollout(s0, actions, spawn(4, 64)).states
    assert np.isfinite(states).all()
    powered = states[(states[..., 16].min(axis=1) > 0)]
    assert len(powered) > 40
    assert np.abs(powered[..., 6:8]).max() < 1.2


# Plans


def test_plans_reach_the_target_on_the_nominal_system() -> None:
    simulator = simulators["uav"]()
    seeds = spawn(6, 100)
    scenarios = simulator.sample_scenarios(seeds)
    actions = simulator.plan(scenarios, seeds)
    nominal = simulator.rollout(scenarios.s0, actions)
    assert simulator.outcome(nominal.states[:, 1:], scenarios.goal).mean() >= 0.85
    noisy = simulator.rollout(scenarios.s0, actions, seeds)
    assert 0.3 < simulator.outcome(noisy.states[:, 1:], scenarios.goal).mean() < 0.75
    assert (actions[:, :, :2] ** 2).sum(-1).max() <= uav_pilot.MAX_SPEED**2 + 1e-3


def test_plans_of_one_scenario_vary_with_the_seed() -> None:
    simulator = simulators["uav"]()
    scenarios = simulator.sample_scenarios(spawn(7, 1).repeat(20))
    actions = simulator.plan(scenarios, spawn(8, 20))
    assert (actions.std(axis=0).mean(axis=0) > [0.3, 0.3, 0.1, 0.05]).all()


# Scene


def test_the_scene_is_the_airframe_of_the_physics() -> None:
    model = simulators["uav"]().scene()
    assert model is not None
    assert model.nq == 7
    body = model.body("uav")
    assert body.mass[0] == physics.MASS
    np.testing.assert_array_equal(body.inertia, physics.INERTIA)
    assert model.opt.gravity[2] == -physics.GRAVITY
    for rotor, place in enumerate(physics.ROTORS):
        np.testing.assert_array_equal(model.site(f"mount_{rotor}").pos[:2], place)
        assert model.geom(f"rotor_{rotor}").size[0] == physics.ROTOR_RADIUS


def test_configuration_is_the_pose_of_the_state() -> None:
    simulator = simulators["uav"]()
    states = still(6).reshape(2, 3, 17)
    states[..., :9] = np.random.default_rng(0).uniform(-1, 1, (2, 3, 9))
    configuration = simulator.configuration(states)
    assert configuration.shape == (2, 3, 7)
    assert np.array_equal(simulator.position(states), states[..., :3])
    model = simulator.scene()
    data = mujoco.MjData(model)
    data.qpos[:] = configuration[1, 2]
    mujoco.mj_kinematics(model, data)
    expected = Rotation.from_euler("ZYX", states[1, 2, [8, 7, 6]].astype(float)).as_matrix()
    np.testing.assert_allclose(data.body("uav").xmat.reshape(3, 3), expected, atol=1e-9)
