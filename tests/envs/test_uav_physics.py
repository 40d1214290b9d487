"""The physics of the UAV: formulas, conservation laws and an independent rigid body."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from study.common.arrays import Doubles
from study.envs import simulators, uav_flight
from study.envs import uav_physics as physics
from study.envs.uav_autopilot import ALLOCATION, _mix
from study.envs.uav_flight import Flight, _rates, _spin
from study.envs.uav_physics import SWARM, Bodies, Weather
from tests.helpers.uav import fly, hover, still


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
