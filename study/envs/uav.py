"""The UAV (paper section V-B): a quadrotor flies to a target in time, in gusts, its load unseen."""

from typing import ClassVar

import mujoco
import numpy as np

from study.common.arrays import Booleans, Doubles, Floats
from study.common.seeds import Seeds
from study.envs.noise import Noise
from study.envs.registration import register
from study.envs.simulator import Episode, Policy, Scenarios, Simulator, Variable, bounds
from study.envs.uav_flight import ANGLES, BATTERY, POSITION, Flight
from study.envs.uav_physics import MAX_PAYLOAD, MEAN_PAYLOAD, MODEL, quaternion
from study.envs.uav_pilot import HABITS, Pilot

SAFE_HEIGHT, RESERVE = 15.0, 30.0
"""m and %: what two of the outcomes ask for."""
SCENARIO_STREAM, POLICY_STREAM, NOISE_STREAM = 0, 1, 2
"""Keep apart what is drawn from the same seed."""

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


@register("uav")
class Uav(Simulator):
    """A quadrotor with an autopilot, a battery, weather, and a payload that nobody sees.

    The airframe and its rotors are those of the PX4 Gazebo model "iris" (`uav_physics` says what is
    published and what was chosen): 1.5 kg without payload, four rotors that each lift up to 7.07 N
    at full charge and lag behind what is asked of them by 0.0125 s (faster) or 0.025 s (slower).
    The top speed of a rotor falls with the charge, to 0.833 of the full one's. Drag acts against
    the air that passes, wind included. The battery holds 8.5 Wh; thrust costs as momentum theory
    says, and the avionics draw 15 W.

    An autopilot (`uav_autopilot`) follows the set-points. It assumes the mean payload, so another
    one shows as height lost or gained, and as drain. Physics and autopilot run at 50 Hz. Axes point
    east, north and up; angles are applied yaw first, then pitch, then roll.

    State:

    | name | unit | meaning | low | high |
    |---|---|---|---|---|
    | x | m | position, east | -5000 | 5000 |
    | y | m | position, north | -5000 | 5000 |
    | z | m | height above the ground | 0 | 5000 |
    | vx | m/s | velocity, east | -100 | 100 |
    | vy | m/s | velocity, north | -100 | 100 |
    | vz | m/s | velocity, up | -100 | 100 |
    | roll | rad | about the body's x axis, third | -3.142 | 3.142 |
    | pitch | rad | about the body's y axis, second | -1.571 | 1.571 |
    | yaw | rad | about the vertical, first; not wrapped | -1000 | 1000 |
    | roll_rate | rad/s | change of roll | -1000 | 1000 |
    | pitch_rate | rad/s | change of pitch | -1000 | 1000 |
    | yaw_rate | rad/s | change of yaw | -1000 | 1000 |
    | wind_x | m/s | wind, east | -100 | 100 |
    | wind_y | m/s | wind, north | -100 | 100 |
    | wind_z | m/s | wind, up | -100 | 100 |
    | temperature | degC | air temperature | -100 | 100 |
    | battery | % | charge that is left | 0 | 100 |

    Action (clipped to its bounds, held for one control step):

    | name | unit | meaning | low | high |
    |---|---|---|---|---|
    | vx | m/s | velocity set-point, east | -8 | 8 |
    | vy | m/s | velocity set-point, north | -8 | 8 |
    | vz | m/s | velocity set-point, up | -3 | 3 |
    | yaw_rate | rad/s | yaw-rate set-point | -1 | 1 |

    Hidden variables (uniform, drawn for each trajectory from its seed):

    | name | unit | meaning | low | high |
    |---|---|---|---|---|
    | payload | kg | mass carried | 0 | 0.6 |

    Task (come within 5 m of the target at any step of the horizon):

    | name | unit | meaning | low | high |
    |---|---|---|---|---|
    | target_x | m | where to fly, east | -5000 | 5000 |
    | target_y | m | where to fly, north | -5000 | 5000 |
    | target_z | m | where to fly, up | 0 | 5000 |

    Start, each uniform, the rest of s0 zero; `rise` shrinks with a horizon below 60:

    | name | unit | meaning | low | high |
    |---|---|---|---|---|
    | x | m | position, east | -20 | 20 |
    | y | m | position, north | -20 | 20 |
    | z | m | height above the ground | 20 | 40 |
    | vx | m/s | velocity, east | -1 | 1 |
    | vy | m/s | velocity, north | -1 | 1 |
    | vz | m/s | velocity, up | -0.3 | 0.3 |
    | yaw | rad | heading | -3.142 | 3.142 |
    | wind | m/s | speed of the level wind | 0 | 9 |
    | wind_towards | rad | where it blows to | -3.142 | 3.142 |
    | wind_z | m/s | wind, up | -0.4 | 0.4 |
    | temperature | degC | air temperature | 0 | 35 |
    | battery | % | charge that is left | 15 | 100 |
    | pace | m/s | level distance of the target, per second of horizon | 0.8 | 5.2 |
    | bearing | rad | direction of the target | -3.142 | 3.142 |
    | rise | m | height of the target above the start | -12 | 15 |

    Policy: `uav_pilot` follows a point that moves along a bowed path to the target, at most at
    8 m/s level, and then waits there. It sees the state at every control step of the nominal
    system, so it makes up for the mean wind; the set-points that it gives there are recorded, and
    that plan is executed. Each flight has habits of its own, uniform:

    | name | unit | meaning | low | high |
    |---|---|---|---|---|
    | arrival | 1 | when the target is reached, as a share of the horizon | 0.35 | 1 |
    | detour | 1 | sideways bow of the path, as a share of its length | -0.2 | 0.2 |
    | climb | m | upward bow of the path | -6 | 10 |
    | gaze | rad | heading, from the direction of flight | -3.142 | 3.142 |
    | zeal | 1/s | velocity per metre behind the moving point | 0.3 | 0.8 |

    Noise. The payload; gusts on top of the wind of s0, which is their mean: Ornstein-Uhlenbeck
    processes that start at zero, in a level wind of W m/s with standard deviation 0.3 + 0.3 W m/s
    and correlation time 8 s level, and 0.2 + 0.12 W m/s and 3 s vertically; the temperature
    wanders likewise, 0.5 degC and 30 s. Without noise: no gust, no wander, payload 0.3 kg.

    Termination: after the horizon, 60 control steps of 0.4 s unless told otherwise. A vehicle that
    comes down to z = 0 stays there to the end: position, yaw and battery as they were, velocity,
    roll, pitch and rates zero, while wind and temperature go on. With an empty battery the rotors
    stop, and it falls.
    """

    name = "uav"
    title = "UAV"
    version = 1
    default_horizon = 60
    control_step = 0.4
    radius = 5.0
    state: ClassVar[tuple[Variable, ...]] = (
        Variable("x", "m", "position, east", -5000.0, 5000.0),
        Variable("y", "m", "position, north", -5000.0, 5000.0),
        Variable("z", "m", "height above the ground", 0.0, 5000.0),
        Variable("vx", "m/s", "velocity, east", -100.0, 100.0),
        Variable("vy", "m/s", "velocity, north", -100.0, 100.0),
        Variable("vz", "m/s", "velocity, up", -100.0, 100.0),
        Variable("roll", "rad", "about the body's x axis, third", -np.pi, np.pi),
        Variable("pitch", "rad", "about the body's y axis, second", -np.pi / 2, np.pi / 2),
        Variable("yaw", "rad", "about the vertical, first; not wrapped", -1000.0, 1000.0),
        Variable("roll_rate", "rad/s", "change of roll", -1000.0, 1000.0),
        Variable("pitch_rate", "rad/s", "change of pitch", -1000.0, 1000.0),
        Variable("yaw_rate", "rad/s", "change of yaw", -1000.0, 1000.0),
        Variable("wind_x", "m/s", "wind, east", -100.0, 100.0),
        Variable("wind_y", "m/s", "wind, north", -100.0, 100.0),
        Variable("wind_z", "m/s", "wind, up", -100.0, 100.0),
        Variable("temperature", "degC", "air temperature", -100.0, 100.0),
        Variable("battery", "%", "charge that is left", 0.0, 100.0),
    )
    action: ClassVar[tuple[Variable, ...]] = (
        Variable("vx", "m/s", "velocity set-point, east", -8.0, 8.0),
        Variable("vy", "m/s", "velocity set-point, north", -8.0, 8.0),
        Variable("vz", "m/s", "velocity set-point, up", -3.0, 3.0),
        Variable("yaw_rate", "rad/s", "yaw-rate set-point", -1.0, 1.0),
    )
    unobserved: ClassVar[tuple[Variable, ...]] = (
        Variable("payload", "kg", "mass carried", 0.0, MAX_PAYLOAD),
    )
    goal: ClassVar[tuple[Variable, ...]] = (
        Variable("target_x", "m", "where to fly, east", -5000.0, 5000.0),
        Variable("target_y", "m", "where to fly, north", -5000.0, 5000.0),
        Variable("target_z", "m", "where to fly, up", 0.0, 5000.0),
    )

    scenario_variables = START
    plotted = ("z", "vz", "battery")
    rotating_pairs = (("roll", "pitch", "yaw"), ("roll_rate", "pitch_rate", "yaw"))

    def sample_scenarios(self, seeds: Seeds) -> Scenarios:
        """Draw one scenario for each seed [N], from `START`."""
        drawn = dict(
            zip((v.name for v in START), _uniform(seeds, SCENARIO_STREAM, START).T, strict=True)
        )
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

    def start(self, s0: Floats, seeds: Seeds | None = None, ahead: int = 1) -> Episode:
        return _Flights(self, s0, seeds, ahead)

    def policy(self, scenarios: Scenarios, seeds: Seeds) -> Policy:
        """A `Pilot` for each scenario, whose habits come from its seed."""
        habits = _uniform(seeds, POLICY_STREAM, HABITS)
        duration = self.horizon * self.control_step
        pilot = Pilot(scenarios.s0, scenarios.goal, habits, duration)
        return lambda step, states: pilot.command(step * self.control_step, states)

    def position(self, states: Floats) -> Floats:
        """The vehicle, [..., 3] in m."""
        return states[..., POSITION]

    def target(self, goal: Floats) -> Floats:
        """The target, [..., 3] in m."""
        return goal

    def scene(self) -> mujoco.MjModel:
        """The quadrotor above a meadow; one free joint."""
        return mujoco.MjModel.from_xml_path(str(MODEL))

    def configuration(self, states: Floats) -> Doubles:
        """qpos [..., 7] of the free joint: position, and orientation as a quaternion wxyz."""
        turned = quaternion(*np.moveaxis(states[..., ANGLES].astype(np.float64), -1, 0))
        return np.concatenate([states[..., POSITION], np.moveaxis(turned, 0, -1)], axis=-1)

    def events(self, states: Floats) -> dict[str, Booleans]:
        """Whether a flight ended on the ground, and whether its battery ran empty."""
        return {
            "it comes down to the ground": np.asarray((states[..., 2] <= 0).any(axis=-1)),
            "its battery runs empty": np.asarray((states[..., BATTERY] <= 0).any(axis=-1)),
        }

    def outcomes(self, states: Floats, goal: Floats) -> dict[str, Booleans]:
        """Also: whether it ends at its target, stays high enough, and keeps a reserve of charge."""
        return super().outcomes(states, goal) | {
            "ends at the target": self.outcome(states[..., -1:, :], goal),
            f"stays above {SAFE_HEIGHT:g} m": np.asarray((states[..., 2] > SAFE_HEIGHT).all(-1)),
            f"keeps {RESERVE:g} % of charge": np.asarray((states[..., BATTERY] > RESERVE).all(-1)),
        }


class _Flights(Episode):
    """N flights at once."""

    def __init__(self, simulator: Uav, s0: Floats, seeds: Seeds | None, ahead: int) -> None:
        self.unobserved = np.full((len(s0), 1), MEAN_PAYLOAD, np.float32)
        generators = []
        if seeds is not None:
            generators = [_generator(seed, NOISE_STREAM) for seed in seeds]
            self.unobserved[:, 0] = [MAX_PAYLOAD * generator.random() for generator in generators]
        self._flight = Flight(s0, self.unobserved[:, 0], simulator.threads)
        self._ticks = round(simulator.control_step / self._flight.timestep)
        self._weather = None
        if seeds is not None:
            self._weather = Noise(generators, (self._ticks, 4), ahead, np.float32)

    def step(self, actions: Floats) -> Floats:
        noise = None if self._weather is None else self._weather.step()
        return self._flight.advance(actions, self._ticks, noise)


def _generator(seed: int, stream: int) -> np.random.Generator:
    """The random numbers that a seed holds for one purpose; it may be used for several."""
    return np.random.Generator(np.random.Philox(key=int(seed) + (stream << 64)))


def _uniform(seeds: Seeds, stream: int, variables: tuple[Variable, ...]) -> Doubles:
    """Each variable between its bounds, [N, len(variables)]."""
    low, high = bounds(variables)
    unit = np.array([_generator(seed, stream).random(len(variables)) for seed in seeds])
    return low + (high - low) * unit.reshape(len(seeds), len(variables))
