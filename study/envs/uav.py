"""The UAV (paper section V-B): a quadrotor flies to a target in time, in gusts, its load unseen."""

from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from study.envs.simulator import Rollout, Scenarios, Simulator, Variable, simulators
from study.envs.uav_flight import ANGLES, POSITION, Flight
from study.envs.uav_physics import MAX_PAYLOAD, MEAN_PAYLOAD, MODEL, quaternion
from study.envs.uav_pilot import HABITS, Pilot
from study.seeds import Seeds

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]

CHUNK = 2048
"""Flights at once: an operation's fixed cost vanishes, and the arrays still fit a cache."""

START = (
    Variable("x", "m", "position, east", -20.0, 20.0),
    Variable("y", "m", "position, north", -20.0, 20.0),
    Variable("z", "m", "height above the ground", 20.0, 40.0),
    Variable("vx", "m/s", "velocity, east", -1.0, 1.0),
    Variable("vy", "m/s", "velocity, north", -1.0, 1.0),
    Variable("vz", "m/s", "velocity, up", -0.3, 0.3),
    Variable("yaw", "rad", "heading", -np.pi, np.pi),
    Variable("wind", "m/s", "speed of the level wind", 0.0, 9.0),
    Variable("wind_towards", "rad", "where it blows to", -np.pi, np.pi),
    Variable("wind_z", "m/s", "wind, up", -0.4, 0.4),
    Variable("temperature", "degC", "air temperature", 0.0, 35.0),
    Variable("battery", "%", "charge that is left", 15.0, 100.0),
    Variable("pace", "m/s", "level distance of the target, per second of horizon", 0.8, 5.2),
    Variable("bearing", "rad", "direction of the target", -np.pi, np.pi),
    Variable("rise", "m", "height of the target above the start", -12.0, 15.0),
)
"""What a scenario is drawn from, each uniform between its bounds. The rest of s0 is zero."""


@simulators.register("uav")
class Uav(Simulator):
    """A quadrotor with an autopilot, a battery, weather, and a payload that nobody sees.

    The airframe and its rotors are those of the PX4 Gazebo model "iris" (see `uav_physics`). An
    action holds for a control step of 0.4 s; physics and autopilot run at 50 Hz. Axes point east,
    north and up; angles are applied yaw first, then pitch, then roll.

    State, 17:

    | # | name | unit | meaning | low | high |
    |---|------|------|---------|-----|------|
    | 0 | x | m | position, east | -inf | inf |
    | 1 | y | m | position, north | -inf | inf |
    | 2 | z | m | height above the ground | 0 | inf |
    | 3 | vx | m/s | velocity, east | -inf | inf |
    | 4 | vy | m/s | velocity, north | -inf | inf |
    | 5 | vz | m/s | velocity, up | -inf | inf |
    | 6 | roll | rad | about the body's x axis, third | -3.142 | 3.142 |
    | 7 | pitch | rad | about the body's y axis, second | -1.571 | 1.571 |
    | 8 | yaw | rad | about the vertical, first; not wrapped | -inf | inf |
    | 9 | roll_rate | rad/s | change of roll | -inf | inf |
    | 10 | pitch_rate | rad/s | change of pitch | -inf | inf |
    | 11 | yaw_rate | rad/s | change of yaw | -inf | inf |
    | 12 | wind_x | m/s | wind, east | -inf | inf |
    | 13 | wind_y | m/s | wind, north | -inf | inf |
    | 14 | wind_z | m/s | wind, up | -inf | inf |
    | 15 | temperature | degC | air temperature | -inf | inf |
    | 16 | battery | % | charge that is left | 0 | 100 |

    Action, 4, clipped to its bounds:

    | # | name | unit | meaning | low | high |
    |---|------|------|---------|-----|------|
    | 0 | vx | m/s | velocity set-point, east | -8 | 8 |
    | 1 | vy | m/s | velocity set-point, north | -8 | 8 |
    | 2 | vz | m/s | velocity set-point, up | -3 | 3 |
    | 3 | yaw_rate | rad/s | yaw-rate set-point | -1 | 1 |

    Hidden, 1, uniform, drawn for each trajectory from its seed:

    | # | name | unit | meaning | low | high |
    |---|------|------|---------|-----|------|
    | 0 | payload | kg | mass carried | 0 | 0.6 |

    Task, 3: come within 5 m of the target at any step:

    | # | name | unit | meaning | low | high |
    |---|------|------|---------|-----|------|
    | 0 | target_x | m | where to fly, east | -inf | inf |
    | 1 | target_y | m | where to fly, north | -inf | inf |
    | 2 | target_z | m | where to fly, up | 0 | inf |

    Start, each uniform, the rest of s0 zero; `rise` shrinks with a horizon below 60:

    | # | name | unit | meaning | low | high |
    |---|------|------|---------|-----|------|
    | 0 | x | m | position, east | -20 | 20 |
    | 1 | y | m | position, north | -20 | 20 |
    | 2 | z | m | height above the ground | 20 | 40 |
    | 3 | vx | m/s | velocity, east | -1 | 1 |
    | 4 | vy | m/s | velocity, north | -1 | 1 |
    | 5 | vz | m/s | velocity, up | -0.3 | 0.3 |
    | 6 | yaw | rad | heading | -3.142 | 3.142 |
    | 7 | wind | m/s | speed of the level wind | 0 | 9 |
    | 8 | wind_towards | rad | where it blows to | -3.142 | 3.142 |
    | 9 | wind_z | m/s | wind, up | -0.4 | 0.4 |
    | 10 | temperature | degC | air temperature | 0 | 35 |
    | 11 | battery | % | charge that is left | 15 | 100 |
    | 12 | pace | m/s | level distance of the target, per second of horizon | 0.8 | 5.2 |
    | 13 | bearing | rad | direction of the target | -3.142 | 3.142 |
    | 14 | rise | m | height of the target above the start | -12 | 15 |

    Policy (see `uav_pilot`), each uniform:

    | # | name | unit | meaning | low | high |
    |---|------|------|---------|-----|------|
    | 0 | arrival | 1 | when the target is reached, as a share of the horizon | 0.35 | 1 |
    | 1 | detour | 1 | sideways bow of the path, as a share of its length | -0.2 | 0.2 |
    | 2 | climb | m | upward bow of the path | -6 | 10 |
    | 3 | gaze | rad | heading, from the direction of flight | -3.142 | 3.142 |
    | 4 | zeal | 1/s | velocity per metre behind the moving point | 0.3 | 0.8 |

    Noise. The payload; gusts on top of the wind of s0, which is their mean: Ornstein-Uhlenbeck
    processes that start at zero, in a level wind of W m/s with standard deviation 0.3 + 0.3 W m/s
    and correlation time 8 s level, and 0.2 + 0.12 W m/s and 3 s vertically; the temperature
    wanders likewise, 0.5 degC and 30 s. Without noise: no gust, no wander, payload 0.3 kg.

    End. The horizon ends a flight. A vehicle that comes down to z = 0 stays there to the end:
    position, yaw and battery as they were, velocity, roll, pitch and rates zero, while wind and
    temperature go on. With an empty battery the rotors stop, and it falls.
    """

    name = "uav"
    version = 1
    default_horizon = 60
    control_step = 0.4
    radius = 5.0
    state: ClassVar[tuple[Variable, ...]] = (
        Variable("x", "m", "position, east"),
        Variable("y", "m", "position, north"),
        Variable("z", "m", "height above the ground", 0.0),
        Variable("vx", "m/s", "velocity, east"),
        Variable("vy", "m/s", "velocity, north"),
        Variable("vz", "m/s", "velocity, up"),
        Variable("roll", "rad", "about the body's x axis, third", -np.pi, np.pi),
        Variable("pitch", "rad", "about the body's y axis, second", -np.pi / 2, np.pi / 2),
        Variable("yaw", "rad", "about the vertical, first; not wrapped"),
        Variable("roll_rate", "rad/s", "change of roll"),
        Variable("pitch_rate", "rad/s", "change of pitch"),
        Variable("yaw_rate", "rad/s", "change of yaw"),
        Variable("wind_x", "m/s", "wind, east"),
        Variable("wind_y", "m/s", "wind, north"),
        Variable("wind_z", "m/s", "wind, up"),
        Variable("temperature", "degC", "air temperature"),
        Variable("battery", "%", "charge that is left", 0.0, 100.0),
    )
    action: ClassVar[tuple[Variable, ...]] = (
        Variable("vx", "m/s", "velocity set-point, east", -8.0, 8.0),
        Variable("vy", "m/s", "velocity set-point, north", -8.0, 8.0),
        Variable("vz", "m/s", "velocity set-point, up", -3.0, 3.0),
        Variable("yaw_rate", "rad/s", "yaw-rate set-point", -1.0, 1.0),
    )
    hidden: ClassVar[tuple[Variable, ...]] = (
        Variable("payload", "kg", "mass carried", 0.0, MAX_PAYLOAD),
    )
    task: ClassVar[tuple[Variable, ...]] = (
        Variable("target_x", "m", "where to fly, east"),
        Variable("target_y", "m", "where to fly, north"),
        Variable("target_z", "m", "where to fly, up", 0.0),
    )

    def __init__(self, horizon: int | None = None, threads: int = 1) -> None:
        super().__init__(horizon, threads)
        self.ticks = round(self.control_step / self.scene().opt.timestep)
        """Physics steps in one control step."""

    def draw(self, seeds: Seeds) -> Scenarios:
        """Draw one scenario for each seed [N], from `START`."""
        drawn = dict(zip((v.name for v in START), _uniform(seeds, 0, START).T, strict=True))
        duration = self.horizon * self.control_step
        s0 = np.zeros((len(seeds), len(self.state)))
        for column, variable in enumerate(self.state):
            if variable.name in drawn:
                s0[:, column] = drawn[variable.name]
        s0[:, 12] = drawn["wind"] * np.cos(drawn["wind_towards"])
        s0[:, 13] = drawn["wind"] * np.sin(drawn["wind_towards"])
        reach = drawn["pace"] * duration
        away = np.stack(
            [
                reach * np.cos(drawn["bearing"]),
                reach * np.sin(drawn["bearing"]),
                drawn["rise"] * min(self.horizon / self.default_horizon, 1.0),
            ],
            axis=1,
        )
        return Scenarios(s0.astype(np.float32), (s0[:, POSITION] + away).astype(np.float32))

    def plan(self, scenarios: Scenarios, seeds: Seeds) -> Floats:
        """Actions [N, T, 4] of a `Pilot` that flies the nominal system closed loop."""
        habits = _uniform(seeds, 1, HABITS)
        actions = np.empty((len(seeds), self.horizon, len(self.action)), np.float32)
        for part in _parts(len(seeds)):
            state, target = scenarios.s0[part], scenarios.task[part]
            pilot = Pilot(state, target, habits[part], self.horizon * self.control_step)
            flight = Flight(state, np.full(len(state), MEAN_PAYLOAD, np.float32), self.threads)
            for step in range(self.horizon):
                wanted = pilot.command(step * self.control_step, state)
                actions[part, step] = self._allowed(wanted)
                state = flight.advance(actions[part, step], self.ticks)
        return actions

    def rollout(self, s0: Floats, actions: Floats, seeds: Seeds, noise: bool = True) -> Rollout:
        """Fly `actions` [N, T, 4], clipped to their bounds, from `s0` [N, 17]."""
        horizon = actions.shape[1]
        states = np.empty((len(s0), horizon + 1, len(self.state)), np.float32)
        states[:, 0] = s0
        hidden = np.full((len(s0), len(self.hidden)), MEAN_PAYLOAD, np.float32)
        for part in _parts(len(s0)):
            kicks: list[Floats] | list[None] = [None] * horizon
            if noise:
                hidden[part, 0], kicks = _chance(seeds[part], horizon, self.ticks)
            flight = Flight(states[part, 0], hidden[part, 0], self.threads)
            for step in range(horizon):
                command = self._allowed(actions[part, step])
                states[part, step + 1] = flight.advance(command, self.ticks, kicks[step])
        return Rollout(states, hidden)

    def position(self, states: Floats) -> Floats:
        """The vehicle, [..., 3] in m."""
        return states[..., POSITION]

    def target(self, task: Floats) -> Floats:
        """The target, [..., 3] in m."""
        return task

    def scene(self) -> mujoco.MjModel:
        """The quadrotor above a meadow; one free joint."""
        return mujoco.MjModel.from_xml_path(str(MODEL))

    def configuration(self, states: Floats) -> Doubles:
        """qpos [..., 7] of the free joint: position, and orientation as a quaternion wxyz."""
        turned = quaternion(*np.moveaxis(states[..., ANGLES].astype(np.float64), -1, 0))
        return np.concatenate([states[..., POSITION], np.moveaxis(turned, 0, -1)], axis=-1)

    def _allowed(self, actions: NDArray[np.floating]) -> Floats:
        low, high = np.array([(v.low, v.high) for v in self.action]).T
        return np.clip(actions, low, high).astype(np.float32)


def _parts(count: int) -> list[slice]:
    return [slice(start, start + CHUNK) for start in range(0, count, CHUNK)]


def _generator(seed: int, stream: int) -> np.random.Generator:
    """The random numbers that a seed holds for one purpose; it may be used for several."""
    return np.random.Generator(np.random.Philox(key=int(seed) + (stream << 64)))


def _uniform(seeds: Seeds, stream: int, variables: tuple[Variable, ...]) -> Doubles:
    """Each variable between its bounds, [N, len(variables)]."""
    low, high = np.array([(variable.low, variable.high) for variable in variables]).T
    unit = np.array([_generator(seed, stream).random(len(variables)) for seed in seeds])
    return low + (high - low) * unit.reshape(len(seeds), len(variables))


def _chance(seeds: Seeds, horizon: int, ticks: int) -> tuple[Floats, list[Floats]]:
    """Payloads [N] in kg, and for each control step the weather's kicks [N, ticks, 4]."""
    payloads = np.empty(len(seeds), np.float32)
    kicks = np.empty((len(seeds), horizon, ticks, 4), np.float32)
    for row, seed in enumerate(seeds):
        generator = _generator(seed, 2)
        payloads[row] = MAX_PAYLOAD * generator.random()
        generator.standard_normal(out=kicks[row], dtype=np.float32)
    return payloads, list(np.moveaxis(kicks, 1, 0))
