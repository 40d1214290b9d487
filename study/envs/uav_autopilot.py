"""The UAV's autopilot: velocity and yaw-rate set-points in, rotor speeds out.

A cascade, as on real vehicles: velocity → acceleration → tilt → turning rate → torque → thrusts.
It assumes the mean payload, full-density air and nothing of the wind, and has an integrator for
the vertical only. So payload, wind and air leave their marks on the flight.
"""

import numpy as np

from study.common.arrays import Doubles
from study.envs.uav_physics import (
    GRAVITY,
    INERTIA,
    MASS,
    MEAN_PAYLOAD,
    ROTORS,
    SPIN_SIGN,
    THRUST_CONSTANT,
    TORQUE_PER_THRUST,
)

ASSUMED_MASS = MASS + MEAN_PAYLOAD
VELOCITY_GAIN = np.array([1.5, 1.5, 2.0])[:, None]  # 1/s
CLIMB_INTEGRAL_GAIN = 0.3  # 1/s²
CLIMB_INTEGRAL_LIMIT = 2.0  # m/s²
TILT_GAIN = 5.0  # 1/s: turning rate per unit of tilt error
RATE_GAIN = np.array([16.0, 16.0, 5.0])[:, None]  # 1/s
MAX_TILT_RATE = 4.0  # rad/s
MAX_TILT = np.tan(np.radians(35.0))  # horizontal over vertical thrust
LIFT_RANGE = np.array([0.4, 1.6]) * GRAVITY  # m/s²
IDLE = 0.03  # of the thrust ceiling: rotors in flight do not stop
YAW_SHARE = 0.15  # of the thrust ceiling, at most, for turning about the vertical

# Thrust and torques from the four thrusts, and its inverse, the mixer.
ALLOCATION = np.stack([np.ones(4), ROTORS[:, 1], -ROTORS[:, 0], -SPIN_SIGN * TORQUE_PER_THRUST])
MIXER = np.linalg.inv(ALLOCATION)[:, :, None]


class Autopilot:
    """The autopilots of N vehicles, each with one number of memory.

    Args:
        count: N.
        timestep: seconds between two calls.
    """

    def __init__(self, count: int, timestep: float) -> None:
        self.timestep = timestep
        self.climb_integral = np.zeros(count)  # m/s²

    def speeds(
        self, command: Doubles, velocity: Doubles, spin: Doubles, matrix: Doubles, top: Doubles
    ) -> Doubles:
        """Rotor speeds to ask for, [4, N] rad/s.

        Args:
            command: [4, N]: velocity m/s in the world, yaw rate rad/s.
            velocity: [3, N] m/s, world.
            spin: [3, N] rad/s, body.
            matrix: [3, 3, N], body to world.
            top: [N] rad/s, the fastest that a rotor can turn now.
        """
        wanted = self._lift(command[:3] - velocity)
        along = wanted[0] * matrix[0, 2] + wanted[1] * matrix[1, 2] + wanted[2] * matrix[2, 2]
        torque = self._torque(wanted, command[3], spin, matrix)
        ceiling = THRUST_CONSTANT * top * top
        return np.sqrt(_mix(ASSUMED_MASS * along, torque, ceiling) / THRUST_CONSTANT)

    def _lift(self, error: Doubles) -> Doubles:
        """Acceleration to ask of the rotors, [3, N] m/s², world, within lift and tilt limits."""
        step = CLIMB_INTEGRAL_GAIN * self.timestep * error[2]
        limit = CLIMB_INTEGRAL_LIMIT
        self.climb_integral = np.clip(self.climb_integral + step, -limit, limit)
        wanted = VELOCITY_GAIN * error
        wanted[2] = np.clip(wanted[2] + self.climb_integral + GRAVITY, *LIFT_RANGE)
        sideways = np.sqrt(wanted[0] * wanted[0] + wanted[1] * wanted[1])
        allowed = MAX_TILT * wanted[2]
        wanted[:2] *= allowed / np.maximum(sideways, allowed)
        return wanted

    def _torque(
        self, wanted: Doubles, yaw_rate: Doubles, spin: Doubles, matrix: Doubles
    ) -> Doubles:
        """Torque [3, N] in N m, body axes, that turns the rotors' axis towards `wanted`."""
        length = np.sqrt(wanted[0] ** 2 + wanted[1] ** 2 + wanted[2] ** 2)
        x, y, z = wanted / length
        rates = np.empty_like(spin)
        # The cross product of the body's z axis with the wanted direction, in body axes.
        rates[0] = -(matrix[0, 1] * x + matrix[1, 1] * y + matrix[2, 1] * z)
        rates[1] = matrix[0, 0] * x + matrix[1, 0] * y + matrix[2, 0] * z
        np.clip(TILT_GAIN * rates[:2], -MAX_TILT_RATE, MAX_TILT_RATE, out=rates[:2])
        rates[2] = yaw_rate * matrix[2, 2]
        return INERTIA[:, None] * RATE_GAIN * (rates - spin)


def _mix(thrust: Doubles, torque: Doubles, ceiling: Doubles) -> Doubles:
    """Thrusts [4, N] within [0, ceiling] for a total thrust [N] and torques [3, N].

    When not all can be had, roll and pitch come first: what is left limits the total thrust. A
    mixer that clips each rotor by itself lets a vehicle at its thrust ceiling flip over.
    """
    yaw_limit = YAW_SHARE * 4 * TORQUE_PER_THRUST * ceiling
    yaw = np.clip(torque[2], -yaw_limit, yaw_limit)
    shares = MIXER[:, 1] * torque[0] + MIXER[:, 2] * torque[1] + MIXER[:, 3] * yaw
    low = np.minimum(np.minimum(shares[0], shares[1]), np.minimum(shares[2], shares[3]))
    high = np.maximum(np.maximum(shares[0], shares[1]), np.maximum(shares[2], shares[3]))
    idle = IDLE * ceiling
    room = ceiling - idle
    scale = room / np.maximum(np.maximum(high - low, room), 1e-9)
    total = np.clip(0.25 * thrust, idle - scale * low, ceiling - scale * high)
    return np.clip(total + scale * shares, 0.0, ceiling)
