"""The UAV: its physics against formulas and an independent rigid body, its noise and plans."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from study.common.arrays import Doubles, Floats
from study.common.seeds import Seeds, spawn
from study.envs import Simulator, simulators, uav, uav_flight, uav_pilot
from study.envs import uav_physics as physics
from study.envs.uav_autopilot import ALLOCATION, _mix
from study.envs.uav_flight import Flight, _rates, _spin
from study.envs.uav_physics import SWARM, Bodies, Weather


def still(count: int, height: float = 30.0, **columns: float) -> Floats:
    """Vehicles [N, 17] at rest in still air of standard temperature, fully charged."""
    names = [variable.name for variable in uav.Uav.state]
    s0 = np.zeros((count, len(names)), np.float32)
    for name, value in ({"z": height, "temperature": 15.0, "battery": 100.0} | columns).items():
        s0[:, names.index(name)] = value
    return s0


def hover(flight: Flight, seconds: float, command: tuple[float, ...] = (0, 0, 0, 0)) -> Floats:
    """The states [N, 17] after a constant command, which is renewed every two seconds."""
    actions = np.tile(np.array(command, np.float32), (flight.count, 1))
    for _ in range(round(seconds / 2)):
        state = flight.advance(actions, round(2.0 / flight.timestep))
    return state


def fly(simulator: Simulator, count: int, seed: int = 0) -> tuple[Floats, Floats, Seeds]:
    """Initial states, plans and seeds of `count` scenarios."""
    seeds = spawn(seed, count)
    scenarios = simulator.sample_scenarios(seeds)
    return scenarios.s0, simulator.plan(scenarios, seeds), seeds


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


# The physics


class NumpyBodies(Bodies):
    """An independent rigid body: Newton and Euler, semi-implicit steps of the same length."""

    def __init__(self, mass: Doubles, step: float | None = None, threads: int = 1) -> None:
        super().__init__(mass, step, threads)
        self.mass = mass

    def write_state(self) -> None: ...

    def step(self, force: Doubles, torque: Doubles, fixed: np.ndarray) -> None:
        moving = ~fixed
        weight = np.array([0.0, 0.0, -physics.GRAVITY])[:, None]
        inertia = physics.INERTIA[:, None]
        gyroscopic = np.cross(self.spin, inertia * self.spin, axis=0)
        self.velocity[:, moving] += (self.timestep * (force / self.mass + weight))[:, moving]
        self.spin[:, moving] += (self.timestep * (torque - gyroscopic) / inertia)[:, moving]
        self.position[:, moving] += self.timestep * self.velocity[:, moving]
        turn = Rotation.from_rotvec(self.timestep * self.spin.T)
        turned = Rotation.from_quat(self.quaternion[[1, 2, 3, 0]].T) * turn
        self.quaternion[:, moving] = turned.as_quat()[:, [3, 0, 1, 2]].T[:, moving]


def test_mujoco_agrees_with_an_independent_rigid_body(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over whole flights in gusts, with states before their rounding to float32."""
    simulator = simulators["uav"]()
    s0, actions, _ = fly(simulator, SWARM, seed=3)
    s0[3, 2], actions[3, :, 2] = 3.0, -3.0  # It crashes.
    payload = np.linspace(0, physics.MAX_PAYLOAD, SWARM)
    ours = Flight(s0, payload)
    monkeypatch.setattr(uav_flight, "Bodies", NumpyBodies)
    theirs = Flight(s0, payload)
    assert isinstance(theirs.bodies, NumpyBodies)
    ticks = round(simulator.control_step / ours.timestep)
    generator = np.random.default_rng(0)
    for step in range(simulator.horizon):
        gusts = generator.standard_normal((SWARM, ticks, 4), np.float32)
        for flight in (ours, theirs):
            flight.advance(actions[:, step], ticks, gusts)
        for quantity in ("position", "velocity", "quaternion", "spin"):
            one, other = (getattr(flight.bodies, quantity) for flight in (ours, theirs))
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(ours.battery, theirs.battery, rtol=1e-9)
    assert ours.crashed[3]
    assert not ours.crashed.all()


def test_a_vehicle_of_the_swarm_moves_like_the_one_of_the_scene() -> None:
    model = simulators["uav"]().scene()
    data = mujoco.MjData(model)
    generator = np.random.default_rng(0)
    bodies = Bodies(np.full(SWARM, physics.MASS))
    bodies.position[:] = generator.normal(size=(3, SWARM))
    bodies.velocity[:] = generator.normal(size=(3, SWARM))
    bodies.spin[:] = generator.normal(size=(3, SWARM))
    bodies.write_state()
    data.qpos[:] = [*bodies.position[:, 7], *bodies.quaternion[:, 7]]
    data.qvel[:] = [*bodies.velocity[:, 7], *bodies.spin[:, 7]]
    for _ in range(200):
        force, torque = generator.normal(size=(2, 3, SWARM))
        torque *= 0.01
        bodies.step(force, torque, np.zeros(SWARM, bool))
        data.qfrc_applied[:] = [*force[:, 7], *torque[:, 7]]
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(bodies.position[:, 7], data.qpos[:3], rtol=1e-12)
    np.testing.assert_allclose(bodies.spin[:, 7], data.qvel[3:], rtol=1e-10)


def test_energy_is_conserved_to_the_order_of_the_integrator() -> None:
    def drift(step: float) -> Doubles:
        bodies = Bodies(np.full(SWARM, physics.MASS), step)
        bodies.velocity[:] = np.array([3.0, -2.0, 6.0])[:, None]
        bodies.spin[:] = np.array([2.0, -1.0, 3.0])[:, None]
        bodies.write_state()
        inertia, zeros = physics.INERTIA[:, None], np.zeros((3, SWARM))

        def energies() -> Doubles:
            motion = 0.5 * physics.MASS * (bodies.velocity**2).sum(0)
            height = physics.MASS * physics.GRAVITY * bodies.position[2]
            return np.stack([motion + height, 0.5 * (inertia * bodies.spin**2).sum(0)])

        before = energies()
        for _ in range(round(2.0 / step)):
            bodies.step(zeros, zeros, np.zeros(SWARM, bool))
        return np.abs(energies() - before)[:, 0]

    coarse, fine = drift(0.02), drift(0.01)
    assert (coarse < [3.0, 0.05]).all()
    np.testing.assert_allclose(coarse / fine, 2.0, rtol=0.1)


def test_rates_and_turning_are_inverse() -> None:
    generator = np.random.default_rng(0)
    angles, rates = generator.uniform(-1.2, 1.2, (2, 3, 50))
    matrix = np.moveaxis(Rotation.from_euler("ZYX", angles[::-1].T).as_matrix(), 0, -1)
    np.testing.assert_allclose(physics.rotation(physics.quaternion(*angles)), matrix, atol=1e-12)
    np.testing.assert_allclose(_rates(matrix, _spin(angles, rates)), rates, atol=1e-12)


def test_hover_in_still_air() -> None:
    payload = np.array([0.0, 0.3, 0.6])
    flight = Flight(still(3, height=60.0), payload)
    before = hover(flight, 60.0)
    weight = (physics.MASS + payload) * physics.GRAVITY
    height, temperature = before[:, 2].astype(float), before[:, 15].astype(float)
    density = physics.air_density(height, temperature)
    constant = physics.THRUST_CONSTANT * density / physics.STANDARD_DENSITY
    thrusts = constant * flight.speeds[:, :3] ** 2
    np.testing.assert_allclose(thrusts.sum(axis=0), weight, rtol=2e-3)

    after = hover(flight, 4.0)
    disc = 2 * density * np.pi * physics.ROTOR_RADIUS**2
    watts = 4 * (weight / 4) ** 1.5 / (physics.FIGURE_OF_MERIT * np.sqrt(disc)) + 15.0
    share = 1 - physics.COLD_LOSS * (25.0 - temperature)
    drained = 100 * watts * 4.0 / (physics.ENERGY * share)
    np.testing.assert_allclose(before[:, 16] - after[:, 16], drained, rtol=3e-3)


def test_a_heavier_payload_sinks_more_and_drains_more() -> None:
    payloads = np.linspace(0, physics.MAX_PAYLOAD, SWARM)
    state = hover(Flight(still(SWARM), payloads), 12.0, (3.0, 1.0, 0.5, 0.2))
    assert (np.diff(state[:, 2]) < 0).all()
    assert (np.diff(state[:, 16]) < 0).all()


def test_terminal_sink_speed_matches_the_drag() -> None:
    flight = Flight(still(1, height=700.0, battery=0.0), np.zeros(1))
    state = hover(flight, 20.0)
    density = physics.air_density(state[:, 2].astype(float), state[:, 15].astype(float))
    weight = physics.MASS * physics.GRAVITY
    assert state[0, 5] == pytest.approx(
        -np.sqrt(2 * weight / (density[0] * physics.DRAG_AREA)), rel=0.01
    )


def test_an_airborne_vehicle_drifts_with_the_wind() -> None:
    state = hover(Flight(still(2, wind_x=6.0), np.full(2, 0.3)), 10.0)
    assert (state[:, 3] > 0.5).all()
    assert np.abs(state[:, 4]).max() < 0.05


def test_set_points_are_followed_and_yaw_is_not_wrapped() -> None:
    state = hover(Flight(still(1, height=50.0), np.array([0.3])), 12.0, (4.0, -2.0, 1.0, 0.8))
    # The velocity loop is proportional: drag leaves it short of the level set-point.
    np.testing.assert_allclose(state[0, 3:6], [4.0, -2.0, 1.0], rtol=0.3)
    assert state[0, 11] == pytest.approx(0.8, rel=0.1)
    assert state[0, 8] > 2 * np.pi


@pytest.mark.parametrize("step", [0.02, 0.4])
def test_gusts_have_the_stated_deviation_and_correlation_time(step: float) -> None:
    count, generator = 4000, np.random.default_rng(0)
    wind = np.array([3.0, 4.0, 0.1])[:, None].repeat(count, 1)
    weather = Weather(wind, np.full(count, 20.0), np.zeros(count), step)
    # From zero the variance grows as 1 - exp(-2 t / time).
    for _ in range(round(4.0 / step)):
        weather.advance(generator.standard_normal((4, count)))
    early, early_heat = weather.wind - wind, weather.temperature(np.zeros(count)) - 20.0
    grown = np.sqrt(1 - np.exp(-8.0 / physics.GUST_TIMES[:, 0]))
    np.testing.assert_allclose(early.std(axis=1), grown * np.array([1.8, 1.8, 0.8]), rtol=0.05)
    for _ in range(round(2.0 / step)):
        weather.advance(generator.standard_normal((4, count)))
    late, late_heat = weather.wind - wind, weather.temperature(np.zeros(count)) - 20.0
    correlation = (early * late).mean(axis=1) / early.var(axis=1)
    np.testing.assert_allclose(correlation, np.exp(-2.0 / physics.GUST_TIMES[:, 0]), atol=0.06)
    heat = physics.TEMPERATURE_STD * np.sqrt(1 - np.exp(-12.0 / physics.TEMPERATURE_TIME))
    assert late_heat.std() == pytest.approx(heat, rel=0.05)
    heat_correlation = (early_heat * late_heat).mean() / early_heat.var()
    assert heat_correlation == pytest.approx(np.exp(-2.0 / physics.TEMPERATURE_TIME), abs=0.06)


def test_top_speed_falls_with_the_charge() -> None:
    speeds = physics.top_speed(np.array([0.0, 1e-6, 50.0, 100.0]))
    assert speeds[0] == 0
    assert speeds[1] == pytest.approx(physics.MAX_SPEED * 3.5 / 4.2)
    assert (np.diff(speeds) > 0).all()
    assert speeds[3] == physics.MAX_SPEED


def test_the_mixer_keeps_attitude_when_thrust_runs_out() -> None:
    generator = np.random.default_rng(0)
    count = 200
    torque = generator.normal(size=(3, count)) * np.array([0.5, 0.5, 0.05])[:, None]
    thrust, ceiling = generator.uniform(0, 40, count), np.full(count, 7.0)
    for factor in (0.4, 3.0):
        thrusts = _mix(thrust, factor * torque, ceiling)
        assert thrusts.min() >= 0
        assert thrusts.max() <= 7.0 + 1e-12
        allocated = ALLOCATION @ thrusts
        # Roll and pitch have a common scale, which is 1 where the ceiling allows it.
        scale = allocated[1] / (factor * torque[0])
        np.testing.assert_allclose(allocated[2], scale * factor * torque[1], atol=1e-9)
        assert scale.max() <= 1 + 1e-9
        assert np.isclose(scale, 1).mean() > (0.99 if factor < 1 else 0.05)
        if factor < 1:
            assert 0.1 < np.isclose(allocated[0], thrust).mean() < 0.9
    assert (_mix(thrust, torque, np.zeros(count)) == 0).all()


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
