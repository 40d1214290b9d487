"""The UAV's autopilot: from velocity and yaw-rate set-points to rotor speeds.

It is a cascade, as on real vehicles: velocity → acceleration → tilt → angular velocity → torque →
thrusts. It assumes the mean payload, air of standard density and no wind, and integrates the error
of the vertical velocity only. So payload, wind and air density have an effect on the flight.
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
TILT_GAIN = 5.0  # 1/s: angular velocity per unit of tilt error
RATE_GAIN = np.array([16.0, 16.0, 5.0])[:, None]  # 1/s
MAX_TILT_RATE = 4.0  # rad/s
MAX_TILT = np.tan(np.radians(35.0))  # horizontal over vertical thrust
LIFT_RANGE = np.array([0.4, 1.6]) * GRAVITY  # m/s²
IDLE = 0.03  # smallest thrust, share of the largest: rotors do not stop in flight
YAW_SHARE = 0.15  # largest share of the largest thrust for yaw

# `ALLOCATION` gives total thrust and torques from the four thrusts; the mixer is its inverse.
ALLOCATION = np.stack([np.ones(4), ROTORS[:, 1], -ROTORS[:, 0], -SPIN_SIGN * TORQUE_PER_THRUST])
MIXER = np.linalg.inv(ALLOCATION)[:, :, None]


class Autopilot:
    """The autopilots of N vehicles. Their only memory is the integrated vertical error.

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
        """Set-points of the rotor speeds.

        Args:
            command: [4, N]: velocity m/s in the world, yaw rate rad/s.
            velocity: [3, N] m/s, world.
            spin: [3, N] rad/s, body.
            matrix: [3, 3, N], body to world.
            top: [N] rad/s, current top speed of a rotor.

        Returns:
            [4, N] rad/s
        """
        desired = self._lift(command[:3] - velocity)
        along = desired[0] * matrix[0, 2] + desired[1] * matrix[1, 2] + desired[2] * matrix[2, 2]
        torque = self._torque(desired, command[3], spin, matrix)
        ceiling = THRUST_CONSTANT * top * top
        return np.sqrt(_mix(ASSUMED_MASS * along, torque, ceiling) / THRUST_CONSTANT)

    def _lift(self, error: Doubles) -> Doubles:
        """Desired acceleration by the rotors, [3, N] m/s², world, within lift and tilt limits."""
        step = CLIMB_INTEGRAL_GAIN * self.timestep * error[2]
        limit = CLIMB_INTEGRAL_LIMIT
        self.climb_integral = np.clip(self.climb_integral + step, -limit, limit)
        desired = VELOCITY_GAIN * error
        desired[2] = np.clip(desired[2] + self.climb_integral + GRAVITY, *LIFT_RANGE)
        sideways = np.sqrt(desired[0] * desired[0] + desired[1] * desired[1])
        allowed = MAX_TILT * desired[2]
        desired[:2] *= allowed / np.maximum(sideways, allowed)
        return desired

    def _torque(
        self, desired: Doubles, yaw_rate: Doubles, spin: Doubles, matrix: Doubles
    ) -> Doubles:
        """Torque [3, N] N m, body axes, that tilts the rotors' axis towards `desired` [3, N]."""
        length = np.sqrt(desired[0] ** 2 + desired[1] ** 2 + desired[2] ** 2)
        x, y, z = desired / length
        rates = np.empty_like(spin)
        # The cross product of the body's z axis with the desired direction, in body axes.
        rates[0] = -(matrix[0, 1] * x + matrix[1, 1] * y + matrix[2, 1] * z)
        rates[1] = matrix[0, 0] * x + matrix[1, 0] * y + matrix[2, 0] * z
        np.clip(TILT_GAIN * rates[:2], -MAX_TILT_RATE, MAX_TILT_RATE, out=rates[:2])
        rates[2] = yaw_rate * matrix[2, 2]
        return INERTIA[:, None] * RATE_GAIN * (rates - spin)


def _mix(thrust: Doubles, torque: Doubles, ceiling: Doubles) -> Doubles:
    """Thrusts [4, N] between zero and `ceiling`, for a total thrust [N] and torques [3, N].

    When the ceiling does not allow all of them, roll and pitch have priority over the total thrust.
    A mixer that clips each rotor separately would let a vehicle at full thrust flip over.
    """
    yaw_limit = YAW_SHARE * 4 * TORQUE_PER_THRUST * ceiling
    yaw = np.clip(torque[2], -yaw_limit, yaw_limit)
    shares = MIXER[:, 1] * torque[0] + MIXER[:, 2] * torque[1] + MIXER[:, 3] * yaw
    low = np.minimum(np.minimum(shares[0], shares[1]), np.minimum(shares[2], shares[3]))
    high = np.maximum(np.maximum(shares[0], shares[1]), np.maximum(shares[2], shares[3]))
    idle = IDLE * ceiling
    margin = ceiling - idle
    scale = margin / np.maximum(np.maximum(high - low, margin), 1e-9)
    total = np.clip(0.25 * thrust, idle - scale * low, ceiling - scale * high)
    return np.clip(total + scale * shares, 0.0, ceiling)
