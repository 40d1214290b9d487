"""The UAV's physics: rigid bodies in MuJoCo, and the forces, power and weather that act on them.

The first axis of an array is the component, the last one the vehicle: ``[3, N]``. Every operation
is elementwise, so a vehicle's numbers do not depend on its batch.

The airframe is the PX4 Gazebo model "iris" (PX4/PX4-SITL_gazebo-classic,
models/iris/iris.sdf.jinja). Its rotor model is that of RotorS (Furrer et al., "RotorS: a modular
Gazebo MAV simulator framework", 2016). Constants that these do not publish are marked "chosen".
"""

from pathlib import Path

import numpy as np
from mujoco.batch import Batch

from study.common.arrays import Booleans, Doubles
from study.envs.swarm import swarm

MODEL = Path(__file__).with_name("uav.xml")
SWARM = 32
"""Vehicles in one MuJoCo world."""

GRAVITY = 9.81
MASS = 1.5  # kg, without payload
INERTIA = np.array([0.029125, 0.029125, 0.055225])  # kg m², principal, body axes
MAX_PAYLOAD = 0.6  # kg, chosen; a point mass at the centre of mass
MEAN_PAYLOAD = MAX_PAYLOAD / 2

ROTORS = np.array([[0.13, -0.22], [-0.13, 0.20], [0.13, 0.22], [-0.13, -0.20]])  # x, y in m
SPIN_SIGN = np.array([1.0, 1.0, -1.0, -1.0])  # +1 counter-clockwise seen from above
THRUST_CONSTANT = 5.84e-6  # N s²/rad²: thrust = constant · speed², in air of standard density
TORQUE_PER_THRUST = 0.06  # m: reaction torque about the rotor's axis
MAX_SPEED = 1100.0  # rad/s, at full voltage: 7.07 N a rotor
SPEED_UP_TIME, SLOW_DOWN_TIME = 0.0125, 0.025  # s, first-order lag of a rotor's speed
ROTOR_DRAG = 1.75e-4  # N s²/(rad m): in the rotor's plane, per rad/s and m/s of airspeed
ROTOR_RADIUS = 0.128  # m

DRAG_AREA = 0.03  # m², chosen: drag coefficient times area of hull and arms, from every side
SPIN_DAMPING = 0.02  # N m s/rad, chosen: aerodynamic damping of the spin

STANDARD_DENSITY = 1.225  # kg/m³
STANDARD_PRESSURE = 101_325.0  # Pa, at z = 0
PRESSURE_LAPSE = 12.01  # Pa/m
GAS_CONSTANT = 287.05  # J/(kg K), dry air
TEMPERATURE_LAPSE = 0.0065  # K/m

ENERGY = 8.5 * 3600.0  # J at 25 degC, chosen: so small that a flight uses much of it
AVIONICS_POWER = 15.0  # W, chosen
FIGURE_OF_MERIT = 0.6  # chosen: ideal over real induced power
EMPTY_VOLTAGE = 3.5 / 4.2  # of a full lithium-polymer cell's; linear in between
COLD_LOSS = 0.005  # unusable share of the energy per K below 25 degC

GUST_TIMES = np.array([8.0, 8.0, 3.0])[:, None]  # s, correlation times of wind x, y, z
TEMPERATURE_TIME, TEMPERATURE_STD = 30.0, 0.5  # s, K


def gust_std(wind: Doubles) -> Doubles:
    """Standard deviations [3, N] of the gusts in m/s, from the mean wind [3, N]."""
    speed = np.sqrt(wind[0] * wind[0] + wind[1] * wind[1])
    horizontal = 0.3 + 0.3 * speed
    return np.stack([horizontal, horizontal, 0.2 + 0.12 * speed])


def air_density(height: Doubles, temperature: Doubles) -> Doubles:
    """Density [N] in kg/m³ of dry air at `height` in m and `temperature` in degC."""
    pressure = STANDARD_PRESSURE - PRESSURE_LAPSE * height
    return pressure / (GAS_CONSTANT * (temperature + 273.15))


def top_speed(battery: Doubles) -> Doubles:
    """Top speed of a rotor, rad/s [N]: proportional to the voltage, which falls with charge."""
    voltage = EMPTY_VOLTAGE + (1 - EMPTY_VOLTAGE) * 0.01 * battery
    return np.where(battery > 0, MAX_SPEED * voltage, 0.0)


def power(thrusts: Doubles, density: Doubles) -> Doubles:
    """Electrical power [N] in W for the thrusts [4, N] by momentum theory, with the avionics."""
    ideal = thrusts * np.sqrt(np.maximum(thrusts, 0.0))
    total = ideal[0] + ideal[1] + ideal[2] + ideal[3]
    disc = np.pi * ROTOR_RADIUS**2
    return total / (FIGURE_OF_MERIT * np.sqrt(2 * disc * density)) + AVIONICS_POWER


def drain(watts: Doubles, temperature: Doubles) -> Doubles:
    """Discharge in % per second [N]; in the cold, less of the energy is usable."""
    usable = 1 - COLD_LOSS * np.clip(25.0 - temperature, 0.0, 60.0)
    return 100.0 * watts / (ENERGY * usable)


def rotation(quaternion: Doubles) -> Doubles:
    """Rotation matrices from body to world, [3, 3, N], of unit quaternions wxyz [4, N]."""
    w, x, y, z = quaternion
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
    wx, wy, wz = w * x, w * y, w * z
    matrix = np.array(
        [
            [0.5 - (yy + zz), xy - wz, xz + wy],
            [xy + wz, 0.5 - (xx + zz), yz - wx],
            [xz - wy, yz + wx, 0.5 - (xx + yy)],
        ]
    )
    matrix *= 2.0
    return matrix


def quaternion(roll: Doubles, pitch: Doubles, yaw: Doubles) -> Doubles:
    """Quaternions wxyz [4, ...] of yaw about z, then pitch about y, then roll about x."""
    cr, sr = np.cos(roll / 2), np.sin(roll / 2)
    cp, sp = np.cos(pitch / 2), np.sin(pitch / 2)
    cy, sy = np.cos(yaw / 2), np.sin(yaw / 2)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


class Weather:
    """Wind and temperature around N vehicles, which fluctuate about the values in s0.

    The fluctuations are Ornstein-Uhlenbeck processes that start at zero. They are sampled exactly,
    so their statistics do not depend on the time step.

    Args:
        wind: [3, N] m/s, the initial wind and the mean of the later one.
        temperature: [N] degC, initial.
        height: [N] m, initial.
        timestep: seconds between two calls of `advance`.
    """

    def __init__(
        self, wind: Doubles, temperature: Doubles, height: Doubles, timestep: float
    ) -> None:
        self._mean, self._temperature_at_zero = wind, temperature + TEMPERATURE_LAPSE * height
        self._gust, self._heat = np.zeros_like(wind), np.zeros_like(height)
        self._gust_decay = np.exp(-timestep / GUST_TIMES)
        self._gust_std = np.sqrt(1 - self._gust_decay**2) * gust_std(wind)
        self._heat_decay = np.exp(-timestep / TEMPERATURE_TIME)
        self._heat_std = np.sqrt(1 - self._heat_decay**2) * TEMPERATURE_STD

    @property
    def wind(self) -> Doubles:
        """[3, N] m/s."""
        return self._mean + self._gust

    def temperature(self, height: Doubles) -> Doubles:
        """degC at `height` in m, [N]."""
        return self._temperature_at_zero - TEMPERATURE_LAPSE * height + self._heat

    def advance(self, normal: Doubles) -> None:
        """Advance one time step, with standard normal numbers [4, N]: wind, then temperature."""
        self._gust = self._gust_decay * self._gust + self._gust_std * normal[:3]
        self._heat = self._heat_decay * self._heat + self._heat_std * normal[3]


class Bodies:
    """N free rigid bodies in MuJoCo, N a multiple of `SWARM`.

    Attributes:
        position: [3, N] m, world.
        quaternion: [4, N] wxyz, body to world.
        velocity: [3, N] m/s, world.
        spin: [3, N] rad/s, body axes.

    Args:
        mass: [N] kg.
        step: seconds of one physics step; None is the model file's own.
        threads: CPU threads.
    """

    def __init__(self, mass: Doubles, step: float | None = None, threads: int = 1) -> None:
        worlds = len(mass) // SWARM
        model = swarm(MODEL, SWARM)
        model.opt.timestep = self.timestep = step or model.opt.timestep
        self._batch = Batch(model, nsim=worlds, nthread=threads)
        self._batch.expand("body_mass")[:, 1:] = mass.reshape(worlds, SWARM)
        self._batch.set_const()
        shape = (worlds, SWARM)
        self._qpos = np.moveaxis(self._batch.bind("qpos").reshape(*shape, 7), 2, 0)
        self._qvel = np.moveaxis(self._batch.bind("qvel").reshape(*shape, 6), 2, 0)
        self._applied = np.moveaxis(self._batch.bind("qfrc_applied").reshape(*shape, 6), 2, 0)
        self._pose, self._motion = np.empty((7, len(mass))), np.empty((6, len(mass)))
        self.position, self.quaternion = self._pose[:3], self._pose[3:]
        self.velocity, self.spin = self._motion[:3], self._motion[3:]
        self._read_state()

    def write_state(self) -> None:
        """Copy the four attributes to MuJoCo's state."""
        self._qpos[...] = self._pose.reshape(self._qpos.shape)
        self._qvel[...] = self._motion.reshape(self._qvel.shape)

    def step(self, force: Doubles, torque: Doubles, fixed: Booleans) -> None:
        """Advance one physics step.

        Args:
            force: [3, N] N, world axes.
            torque: [3, N] N m, body axes.
            fixed: [N] whether a body does not move.
        """
        self._applied[:3] = force.reshape(3, *self._applied.shape[1:])
        self._applied[3:] = torque.reshape(3, *self._applied.shape[1:])
        self._batch.step()
        if fixed.any():
            free = ~fixed.reshape(self._qpos.shape[1:])
            np.copyto(self._pose.reshape(self._qpos.shape), self._qpos, where=free)
            np.copyto(self._motion.reshape(self._qvel.shape), self._qvel, where=free)
            self.write_state()
        else:
            self._read_state()

    def _read_state(self) -> None:
        self._pose.reshape(self._qpos.shape)[...] = self._qpos
        self._motion.reshape(self._qvel.shape)[...] = self._qvel
