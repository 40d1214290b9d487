"""Many UAVs in flight: autopilots, rotors, air, batteries and weather around the rigid bodies."""

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
    """N UAVs that fly from `s0` at once, without a word to each other.

    What is not in the state starts as a function of it: rotors turn as in a hover with the mean
    payload, the autopilot's integrator is zero, the mean wind is the wind of s0 and the gust zero.

    A vehicle that comes down to z = 0 has crashed: it stays where it came down, level, at rest,
    with rotors and battery off and its heading kept. One whose battery is empty stops its rotors.

    Args:
        s0: [N, 17].
        payload: [N] kg.
        threads: CPU threads of the rigid bodies.
        timestep: seconds of one physics step; the model file's own if None.
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
        self.bodies.place()
        self.crashed = np.zeros(size, bool)
        self._ground()
        self._speed_up = 1 - np.exp(-self.timestep / SPEED_UP_TIME)
        self._slow_down = 1 - np.exp(-self.timestep / SLOW_DOWN_TIME)

    def advance(
        self, actions: Floats, ticks: int, noise: NDArray[np.floating] | None = None
    ) -> Floats:
        """Hold `actions` [N, 4] for `ticks` physics steps; the states [N, 17] thereafter.

        Args:
            actions: velocity in m/s, world, and yaw rate in rad/s.
            ticks: physics steps; less than half a turn, or the yaw loses count.
            noise: [N, ticks, 4] standard normal numbers, for gusts and temperature; none: still.
        """
        command = self._fill(np.asarray(actions, np.float64))
        kicks = None if noise is None else self._fill(noise)
        for tick in range(ticks):
            if kicks is not None:
                self.weather.advance(kicks[tick])
            self._tick(command)
        return self._observe()

    def _fill(self, values: NDArray[np.generic]) -> Doubles:
        """[N, ...] as [..., P], P the next multiple of the swarm's size: the last is repeated."""
        rest = -len(values) % SWARM
        full = np.concatenate([values, values[-1:].repeat(rest, 0)]) if rest else values
        return np.ascontiguousarray(np.moveaxis(full, 0, -1), np.float64)

    def _tick(self, command: Doubles) -> None:
        bodies = self.bodies
        matrix = rotation(bodies.quaternion)
        temperature = self.weather.temperature(bodies.position[2])
        density = air_density(bodies.position[2], temperature)
        asked = self.autopilot.speeds(
            command, bodies.velocity, bodies.spin, matrix, top_speed(self.battery)
        )
        change = asked - self.speeds
        self.speeds += np.where(change > 0, self._speed_up, self._slow_down) * change
        thrusts = (THRUST_CONSTANT / STANDARD_DENSITY) * density * self.speeds * self.speeds
        used = drain(power(thrusts, density), temperature) * self.timestep
        self.battery = np.where(self.crashed, self.battery, np.maximum(self.battery - used, 0.0))
        bodies.step(self._force(thrusts, matrix, density), self._torque(thrusts), self.crashed)
        self._ground()

    def _force(self, thrusts: Doubles, matrix: Doubles, density: Doubles) -> Doubles:
        """Thrust, rotor drag and hull drag, [3, N] in N, world."""
        axis = matrix[:, 2]
        air = self.weather.wind - self.bodies.velocity
        along = air[0] * axis[0] + air[1] * axis[1] + air[2] * axis[2]
        airspeed = np.sqrt(air[0] * air[0] + air[1] * air[1] + air[2] * air[2])
        speeds, lift = _total(self.speeds), _total(thrusts)
        rotor = ROTOR_DRAG * speeds
        hull = 0.5 * DRAG_AREA * density * airspeed
        # Rotors drag in their plane only: take away the air that comes along the axis.
        return (rotor + hull) * air + (lift - rotor * along) * axis

    def _torque(self, thrusts: Doubles) -> Doubles:
        """Of the rotors' pull and reaction, and of the air, [3, N] in N m, body axes."""
        first, second, third, fourth = thrusts
        (x0, y0), (x1, y1), (x2, y2), (x3, y3) = ROTORS
        torque = -SPIN_DAMPING * self.bodies.spin
        torque[0] += y0 * first + y1 * second + y2 * third + y3 * fourth
        torque[1] -= x0 * first + x1 * second + x2 * third + x3 * fourth
        reaction = SPIN_SIGN[:, None] * thrusts
        torque[2] -= TORQUE_PER_THRUST * _total(reaction)
        return torque

    def _ground(self) -> None:
        """Bring to rest, level, on the ground, whoever has just come down to it."""
        bodies = self.bodies
        fresh = (bodies.position[2] <= 0) & ~self.crashed
        if not fresh.any():
            return
        _, _, heading = _angles(rotation(bodies.quaternion[:, fresh]))
        level = np.zeros_like(heading)
        bodies.position[2, fresh] = 0.0
        bodies.quaternion[:, fresh] = quaternion(level, level, heading)
        bodies.velocity[:, fresh] = bodies.spin[:, fresh] = self.speeds[:, fresh] = 0.0
        bodies.place()
        self.crashed |= fresh

    def _observe(self) -> Floats:
        """The states [N, 17] as they are now."""
        bodies = self.bodies
        matrix = rotation(bodies.quaternion)
        roll, pitch, heading = _angles(matrix)
        turned = heading - self.yaw
        self.yaw = self.yaw + (turned - 2 * np.pi * np.round(turned / (2 * np.pi)))
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


def _total(four: Doubles) -> Doubles:
    return (four[0] + four[1]) + (four[2] + four[3])


def _angles(matrix: Doubles) -> tuple[Doubles, Doubles, Doubles]:
    """Roll and heading in [-π, π] and pitch in [-π/2, π/2], [N] each, of matrices [3, 3, N]."""
    roll = np.arctan2(matrix[2, 1], matrix[2, 2])
    pitch = np.arcsin(np.clip(-matrix[2, 0], -1.0, 1.0))
    return roll, pitch, np.arctan2(matrix[1, 0], matrix[0, 0])


def _spin(angles: Doubles, rates: Doubles) -> Doubles:
    """Turning in body axes [3, N] of the rates of roll, pitch and yaw [3, N]."""
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
    """Rates of roll, pitch and yaw [3, N] of the turning in body axes [3, N].

    At a pitch of 90 degrees they are not defined: there the cosine is held at 0.05.
    """
    level = np.sqrt(matrix[2, 1] ** 2 + matrix[2, 2] ** 2)
    sine, cosine = matrix[2, 1] / np.maximum(level, 1e-9), matrix[2, 2] / np.maximum(level, 1e-9)
    yaw = (sine * spin[1] + cosine * spin[2]) / np.maximum(level, 0.05)
    return np.stack([spin[0] - matrix[2, 0] * yaw, cosine * spin[1] - sine * spin[2], yaw])
