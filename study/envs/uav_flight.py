"""UAVs in flight: the rigid bodies with their autopilots, rotors, batteries and weather."""

import numpy as np
from numpy.typing import NDArray

from study.common.arrays import Doubles, Floats
from study.envs.uav_autopilot import ASSUMED_MASS, Autopilot
from study.envs.uav_physics import (
    DRAG_AREA,
    GRAVITY,
    MASS,
    ROTOR_DRAG,
    ROTORS,
    SLOW_DOWN_TIME,
    SPEED_UP_TIME,
    SPIN_DAMPING,
    SPIN_SIGN,
    STANDARD_DENSITY,
    SWARM,
    THRUST_CONSTANT,
    TORQUE_PER_THRUST,
    Bodies,
    Weather,
    air_density,
    drain,
    power,
    quaternion,
    rotation,
    top_speed,
)

POSITION, VELOCITY, ANGLES = slice(0, 3), slice(3, 6), slice(6, 9)
RATES, WIND, TEMPERATURE, BATTERY = slice(9, 12), slice(12, 15), 15, 16


class Flight:
    """N independent UAVs that fly from `s0`.

    The rotors, the autopilot and the gusts are not part of the state. They start with the rotor
    speed of a hover with the mean payload, an integrator of zero, and a gust of zero.

    A vehicle that comes down to z = 0 has crashed. It stays there, level and at rest, with its
    heading, and with rotors and battery off. When the battery is empty the rotors stop.

    Args:
        s0: [N, 17] initial states.
        payload: [N] kg.
        threads: CPU threads of the rigid bodies.
        timestep: seconds of one physics step; None is the model file's own.
    """

    def __init__(
        self,
        s0: Floats,
        payload: NDArray[np.floating],
        threads: int = 1,
        timestep: float | None = None,
    ) -> None:
        self.count = len(s0)
        state = self._fill(np.asarray(s0, np.float64))
        size = state.shape[1]
        self.bodies = Bodies(MASS + self._fill(payload), timestep, threads)
        self.timestep = self.bodies.timestep
        self.autopilot = Autopilot(size, self.timestep)
        self.yaw = state[8].copy()
        self.battery = state[BATTERY].copy()
        self.weather = Weather(state[WIND], state[TEMPERATURE], state[2], self.timestep)
        hover = np.sqrt(ASSUMED_MASS * GRAVITY / (4 * THRUST_CONSTANT))
        self.speeds = np.minimum(hover, top_speed(self.battery))[None].repeat(4, 0)
        self.bodies.position[:], self.bodies.velocity[:] = state[POSITION], state[VELOCITY]
        self.bodies.quaternion[:] = quaternion(*state[ANGLES])
        self.bodies.spin[:] = _spin(state[ANGLES], state[RATES])
        self.bodies.write_state()
        self.crashed = np.zeros(size, bool)
        self._land()
        self._speed_up = 1 - np.exp(-self.timestep / SPEED_UP_TIME)
        self._slow_down = 1 - np.exp(-self.timestep / SLOW_DOWN_TIME)

    def advance(
        self, actions: Floats, ticks: int, noise: NDArray[np.floating] | None = None
    ) -> Floats:
        """Hold the actions for some physics steps.

        Args:
            actions: [N, 4], velocity in m/s, world axes, and yaw rate in rad/s.
            ticks: physics steps. Within these a vehicle must yaw by less than half a revolution,
                since the yaw is not wrapped.
            noise: [N, ticks, 4] standard normal numbers for gusts and temperature; None for the
                nominal system.

        Returns:
            The states after the last step, [N, 17].
        """
        command = self._fill(np.asarray(actions, np.float64))
        normal = None if noise is None else self._fill(noise)
        for tick in range(ticks):
            if normal is not None:
                self.weather.advance(normal[tick])
            self._tick(command)
        return self._observe()

    def _fill(self, values: NDArray[np.generic]) -> Doubles:
        """Values [N, ...] as [..., P], P a multiple of `SWARM`; copies of the last one fill it."""
        rest = -len(values) % SWARM
        full = np.concatenate([values, values[-1:].repeat(rest, 0)]) if rest else values
        return np.ascontiguousarray(np.moveaxis(full, 0, -1), np.float64)

    def _tick(self, command: Doubles) -> None:
        bodies = self.bodies
        matrix = rotation(bodies.quaternion)
        temperature = self.weather.temperature(bodies.position[2])
        density = air_density(bodies.position[2], temperature)
        set_points = self.autopilot.speeds(
            command, bodies.velocity, bodies.spin, matrix, top_speed(self.battery)
        )
        change = set_points - self.speeds
        self.speeds += np.where(change > 0, self._speed_up, self._slow_down) * change
        thrusts = (THRUST_CONSTANT / STANDARD_DENSITY) * density * self.speeds * self.speeds
        used = drain(power(thrusts, density), temperature) * self.timestep
        self.battery = np.where(self.crashed, self.battery, np.maximum(self.battery - used, 0.0))
        bodies.step(self._force(thrusts, matrix, density), self._torque(thrusts), self.crashed)
        self._land()

    def _force(self, thrusts: Doubles, matrix: Doubles, density: Doubles) -> Doubles:
        """Thrust, rotor drag and hull drag, [3, N] N, world axes."""
        axis = matrix[:, 2]
        air = self.weather.wind - self.bodies.velocity
        along = air[0] * axis[0] + air[1] * axis[1] + air[2] * axis[2]
        airspeed = np.sqrt(air[0] * air[0] + air[1] * air[1] + air[2] * air[2])
        speeds, lift = _total(self.speeds), _total(thrusts)
        rotor = ROTOR_DRAG * speeds
        hull = 0.5 * DRAG_AREA * density * airspeed
        # A rotor has drag in its plane only, so the airflow along its axis is subtracted.
        return (rotor + hull) * air + (lift - rotor * along) * axis

    def _torque(self, thrusts: Doubles) -> Doubles:
        """Torque of thrusts, reactions and damping, [3, N] N m, body axes."""
        first, second, third, fourth = thrusts
        (x0, y0), (x1, y1), (x2, y2), (x3, y3) = ROTORS
        torque = -SPIN_DAMPING * self.bodies.spin
        torque[0] += y0 * first + y1 * second + y2 * third + y3 * fourth
        torque[1] -= x0 * first + x1 * second + x2 * third + x3 * fourth
        reaction = SPIN_SIGN[:, None] * thrusts
        torque[2] -= TORQUE_PER_THRUST * _total(reaction)
        return torque

    def _land(self) -> None:
        """Put vehicles that have just come down to the ground to rest there, level."""
        bodies = self.bodies
        landed = (bodies.position[2] <= 0) & ~self.crashed
        if not landed.any():
            return
        _, _, heading = _angles(rotation(bodies.quaternion[:, landed]))
        level = np.zeros_like(heading)
        bodies.position[2, landed] = 0.0
        bodies.quaternion[:, landed] = quaternion(level, level, heading)
        bodies.velocity[:, landed] = bodies.spin[:, landed] = self.speeds[:, landed] = 0.0
        bodies.write_state()
        self.crashed |= landed

    def _observe(self) -> Floats:
        """The current states, [N, 17]."""
        bodies = self.bodies
        matrix = rotation(bodies.quaternion)
        roll, pitch, heading = _angles(matrix)
        change = heading - self.yaw
        self.yaw = self.yaw + (change - 2 * np.pi * np.round(change / (2 * np.pi)))
        state = np.concatenate(
            [
                bodies.position,
                bodies.velocity,
                [roll, pitch, self.yaw],
                _rates(matrix, bodies.spin),
                self.weather.wind,
                [self.weather.temperature(bodies.position[2]), self.battery],
            ]
        )
        return np.ascontiguousarray(state[:, : self.count].T, np.float32)


def _total(values: Doubles) -> Doubles:
    """Sum over the rotors, [N], of values [4, N]."""
    return (values[0] + values[1]) + (values[2] + values[3])


def _angles(matrix: Doubles) -> tuple[Doubles, Doubles, Doubles]:
    """Roll, pitch and heading, [N] each, of matrices from body to world [3, 3, N]."""
    roll = np.arctan2(matrix[2, 1], matrix[2, 2])
    pitch = np.arcsin(np.clip(-matrix[2, 0], -1.0, 1.0))
    return roll, pitch, np.arctan2(matrix[1, 0], matrix[0, 0])


def _spin(angles: Doubles, rates: Doubles) -> Doubles:
    """Angular velocity in body axes [3, N], from the rates of roll, pitch and yaw [3, N]."""
    roll, pitch, _ = angles
    cr, sr, cp = np.cos(roll), np.sin(roll), np.cos(pitch)
    return np.stack(
        [
            rates[0] - np.sin(pitch) * rates[2],
            cr * rates[1] + sr * cp * rates[2],
            cr * cp * rates[2] - sr * rates[1],
        ]
    )


def _rates(matrix: Doubles, spin: Doubles) -> Doubles:
    """Rates of roll, pitch and yaw [3, N], from the angular velocity in body axes [3, N].

    The rates diverge at a pitch of 90°, so the cosine of the pitch is at least 0.05.
    """
    level = np.sqrt(matrix[2, 1] ** 2 + matrix[2, 2] ** 2)
    sine, cosine = matrix[2, 1] / np.maximum(level, 1e-9), matrix[2, 2] / np.maximum(level, 1e-9)
    yaw = (sine * spin[1] + cosine * spin[2]) / np.maximum(level, 0.05)
    return np.stack([spin[0] - matrix[2, 0] * yaw, cosine * spin[1] - sine * spin[2], yaw])
