"""The UAV (paper section IV-B): a quadrotor with an unobserved payload flies through gusts."""

from typing import ClassVar

import mujoco
import numpy as np

from study.common.arrays import Booleans, Doubles, Floats
from study.common.seeds import Seeds
from study.data.symmetries import Mirror, Shift, Symmetries, Turn
from study.data.variables import Constant, Variable, bounds
from study.envs import uav_physics
from study.envs.noise import Noise
from study.envs.registration import register
from study.envs.simulator import Episode, Policy, Scenarios, Simulator
from study.envs.uav_flight import ANGLES, BATTERY, POSITION, Flight
from study.envs.uav_physics import MAX_PAYLOAD, MEAN_PAYLOAD, MODEL, quaternion
from study.envs.uav_pilot import MAX_SPEED, POLICY_VARIABLES, Pilot

SAFE_HEIGHT = 15.0
"""m, smallest height of an outcome."""
RESERVE = 30.0
"""%, smallest charge of an outcome."""
SCENARIO_STREAM, POLICY_STREAM, NOISE_STREAM = 0, 1, 2
"""Independent random streams of one seed."""

SCENARIO_VARIABLES = (
    Variable("x", "m", "position, east", -20.0, 20.0),
    Variable("y", "m", "position, north", -20.0, 20.0),
    Variable("z", "m", "height above the ground", 20.0, 40.0),
    Variable("vx", "m/s", "velocity, east", -1.0, 1.0),
    Variable("vy", "m/s", "velocity, north", -1.0, 1.0),
    Variable("vz", "m/s", "velocity, up", -0.3, 0.3),
    Variable("yaw", "rad", "heading", -np.pi, np.pi),
    Variable("wind", "m/s", "speed of the level wind", 0.0, 9.0),
    Variable("wind_towards", "rad", "direction that the wind blows to", -np.pi, np.pi),
    Variable("wind_z", "m/s", "wind, up", -0.4, 0.4),
    Variable("temperature", "degC", "air temperature", 0.0, 35.0),
    Variable("battery", "%", "remaining charge", 15.0, 100.0),
    Variable("pace", "m/s", "level distance to the target per second of horizon", 0.8, 5.2),
    Variable("bearing", "rad", "direction of the target", -np.pi, np.pi),
    Variable("rise", "m", "height of the target above the start", -12.0, 15.0),
)
"""A scenario is sampled from these, uniformly between the bounds. The rest of s0 is zero."""


@register("uav")
class Uav(Simulator):
    """A quadrotor with an autopilot, a battery, weather, and an unobserved payload.

    The airframe and the rotors are those of the PX4 Gazebo model "iris"; `uav_physics` marks the
    constants that were chosen. The speed of a rotor follows its set-point with a lag, and its top
    speed falls with the charge. Drag acts against the airflow, wind included. Power follows
    momentum theory. Axes point east, north and up. Yaw is applied first, then pitch, then roll.

    **Action.** Velocity and yaw-rate set-points, clipped to their bounds and held for one control
    step. An autopilot (`uav_autopilot`) follows them. It assumes the mean payload. So a vehicle
    with another payload loses or gains height and drains its battery at another rate.

    **Noise.** The payload, gusts, and fluctuations of the temperature. The wind of s0 is the mean
    wind. Gusts and fluctuations are Ornstein-Uhlenbeck processes that start at zero. The standard
    deviation of a gust is linear in the speed W of the mean level wind. The nominal system has the
    mean payload and neither gusts nor fluctuations.

    **Scenario.** The variables are uniform and independent; the rest of s0 is zero. `rise` is
    reduced in proportion when the horizon is shorter than the system's own.

    **Outcome.** The vehicle comes within the goal radius of the target at any step of the horizon.
    A vehicle that comes down to the ground stays there: its position, yaw and battery stay as they
    were, its velocity, roll, pitch and rates are zero, and wind and temperature go on. When the
    battery is empty the rotors stop, and the vehicle falls.

    **Policy.** `uav_pilot` follows a point that moves to the target along a curved path and then
    waits there. It is planned in closed loop on the nominal system, so it compensates for the mean
    wind but not for gusts. Each trajectory has its own policy parameters.
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
        Variable("roll", "rad", "angle about the body's x axis", -np.pi, np.pi),
        Variable("pitch", "rad", "angle about the body's y axis", -np.pi / 2, np.pi / 2),
        Variable("yaw", "rad", "angle about the vertical, not wrapped", -1000.0, 1000.0),
        Variable("roll_rate", "rad/s", "rate of roll", -1000.0, 1000.0),
        Variable("pitch_rate", "rad/s", "rate of pitch", -1000.0, 1000.0),
        Variable("yaw_rate", "rad/s", "rate of yaw", -1000.0, 1000.0),
        Variable("wind_x", "m/s", "wind, east", -100.0, 100.0),
        Variable("wind_y", "m/s", "wind, north", -100.0, 100.0),
        Variable("wind_z", "m/s", "wind, up", -100.0, 100.0),
        Variable("temperature", "degC", "air temperature", -100.0, 100.0),
        Variable("battery", "%", "remaining charge", 0.0, 100.0),
    )
    action: ClassVar[tuple[Variable, ...]] = (
        Variable("vx", "m/s", "velocity set-point, east", -8.0, 8.0),
        Variable("vy", "m/s", "velocity set-point, north", -8.0, 8.0),
        Variable("vz", "m/s", "velocity set-point, up", -3.0, 3.0),
        Variable("yaw_rate", "rad/s", "yaw-rate set-point", -1.0, 1.0),
    )
    unobserved: ClassVar[tuple[Variable, ...]] = (
        Variable("payload", "kg", "mass of the payload", 0.0, MAX_PAYLOAD),
    )
    goal: ClassVar[tuple[Variable, ...]] = (
        Variable("target_x", "m", "target, east", -5000.0, 5000.0),
        Variable("target_y", "m", "target, north", -5000.0, 5000.0),
        Variable("target_z", "m", "target, up", 0.0, 5000.0),
    )

    scenario_variables = SCENARIO_VARIABLES
    policy_variables = POLICY_VARIABLES
    plotted = ("z", "vz", "battery")
    rotating_pairs = (("roll", "pitch", "yaw"), ("roll_rate", "pitch_rate", "yaw"))
    # Height is no symmetry: the air is thinner and colder above, and there is the ground.
    symmetries = Symmetries(
        turn=Turn(
            states=(("x", "y"), ("vx", "vy"), ("wind_x", "wind_y")),
            actions=(("vx", "vy"),),
            goal=(("target_x", "target_y"),),
            angles=("yaw",),
        ),
        mirror=Mirror(
            states=("y", "vy", "roll", "yaw", "roll_rate", "yaw_rate", "wind_y"),
            actions=("vy", "yaw_rate"),
            goal=("target_y",),
        ),
        shifts=(
            Shift(-20.0, 20.0, states=("x",), goal=("target_x",)),
            Shift(-20.0, 20.0, states=("y",), goal=("target_y",)),
        ),
    )

    def sample_scenarios(self, seeds: Seeds) -> Scenarios:
        """One scenario for each seed [N], from `SCENARIO_VARIABLES`."""
        names = [variable.name for variable in SCENARIO_VARIABLES]
        columns = _uniform(seeds, SCENARIO_STREAM, SCENARIO_VARIABLES).T
        sampled = dict(zip(names, columns, strict=True))
        duration = self.horizon * self.control_step
        s0 = np.zeros((len(seeds), len(self.state)))
        for column, variable in enumerate(self.state):
            if variable.name in sampled:
                s0[:, column] = sampled[variable.name]
        s0[:, 12] = sampled["wind"] * np.cos(sampled["wind_towards"])
        s0[:, 13] = sampled["wind"] * np.sin(sampled["wind_towards"])
        distance = sampled["pace"] * duration
        displacement = np.stack(
            [
                distance * np.cos(sampled["bearing"]),
                distance * np.sin(sampled["bearing"]),
                sampled["rise"] * min(self.horizon / self.default_horizon, 1.0),
            ],
            axis=1,
        )
        return Scenarios(s0.astype(np.float32), (s0[:, POSITION] + displacement).astype(np.float32))

    def start_episode(
        self, s0: Floats, seeds: Seeds | None = None, noise_steps: int = 1
    ) -> Episode:
        return _UavEpisode(self, s0, seeds, noise_steps)

    def policy(self, scenarios: Scenarios, seeds: Seeds) -> Policy:
        """A `Pilot` for each scenario, with parameters that are sampled with its seed."""
        parameters = _uniform(seeds, POLICY_STREAM, POLICY_VARIABLES)
        duration = self.horizon * self.control_step
        pilot = Pilot(scenarios.s0, scenarios.goal, parameters, duration)
        return lambda step, states: pilot.command(step * self.control_step, states)

    def position(self, states: Floats) -> Floats:
        """The vehicle's position, [..., 3] m."""
        return states[..., POSITION]

    def target(self, goal: Floats) -> Floats:
        """The target's position, [..., 3] m."""
        return goal

    def scene(self) -> mujoco.MjModel:
        """The quadrotor above a meadow; one free joint."""
        return mujoco.MjModel.from_xml_path(str(MODEL))

    def configuration(self, states: Floats) -> Doubles:
        """qpos [..., 7] of the free joint: position, and orientation as a quaternion wxyz."""
        orientation = quaternion(*np.moveaxis(states[..., ANGLES].astype(np.float64), -1, 0))
        return np.concatenate([states[..., POSITION], np.moveaxis(orientation, 0, -1)], axis=-1)

    def constants(self) -> tuple[Constant, ...]:
        physics = uav_physics
        level, vertical = "level gusts", "vertical gusts"
        calm, breeze = physics.gust_std(np.array([[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]])).T
        thrust = physics.THRUST_CONSTANT * physics.MAX_SPEED**2
        return (
            Constant("physics step", float(self.scene().opt.timestep), "s"),
            Constant("mass without payload", physics.MASS, "kg"),
            Constant("payload of the nominal system", MEAN_PAYLOAD, "kg"),
            Constant("largest thrust of a rotor, full battery", thrust, "N"),
            Constant("time constant of a rotor, faster", physics.SPEED_UP_TIME, "s"),
            Constant("time constant of a rotor, slower", physics.SLOW_DOWN_TIME, "s"),
            Constant("top speed of a rotor, empty over full battery", physics.EMPTY_VOLTAGE, "1"),
            Constant("energy of the full battery", physics.ENERGY / 3600, "Wh"),
            Constant("power of the avionics", physics.AVIONICS_POWER, "W"),
            Constant(f"standard deviation of {level}, W = 0", calm[0], "m/s"),
            Constant(f"standard deviation of {level}, per unit of W", breeze[0] - calm[0], "1"),
            Constant(f"correlation time of {level}", physics.GUST_TIMES[0, 0], "s"),
            Constant(f"standard deviation of {vertical}, W = 0", calm[2], "m/s"),
            Constant(f"standard deviation of {vertical}, per unit of W", breeze[2] - calm[2], "1"),
            Constant(f"correlation time of {vertical}", physics.GUST_TIMES[2, 0], "s"),
            Constant("standard deviation of the temperature", physics.TEMPERATURE_STD, "degC"),
            Constant("correlation time of the temperature", physics.TEMPERATURE_TIME, "s"),
            Constant("policy: largest level speed set-point", MAX_SPEED, "m/s"),
        )

    def events(self, states: Floats) -> dict[str, Booleans]:
        """Whether the vehicle comes down to the ground, and whether its battery is empty."""
        return {
            "the vehicle comes down to the ground": np.asarray((states[..., 2] <= 0).any(axis=-1)),
            "the battery becomes empty": np.asarray((states[..., BATTERY] <= 0).any(axis=-1)),
        }

    def outcomes(self, states: Floats, goal: Floats) -> dict[str, Booleans]:
        """The goal, ending at the target, staying above a height, and keeping a charge reserve."""
        return super().outcomes(states, goal) | {
            "ends at the target": self.outcome(states[..., -1:, :], goal),
            f"stays above {SAFE_HEIGHT:g} m": np.asarray((states[..., 2] > SAFE_HEIGHT).all(-1)),
            f"keeps {RESERVE:g} % of charge": np.asarray((states[..., BATTERY] > RESERVE).all(-1)),
        }


class _UavEpisode(Episode):
    """N flights."""

    def __init__(self, simulator: Uav, s0: Floats, seeds: Seeds | None, noise_steps: int) -> None:
        self.unobserved = np.full((len(s0), 1), MEAN_PAYLOAD, np.float32)
        generators = []
        if seeds is not None:
            generators = [_generator(seed, NOISE_STREAM) for seed in seeds]
            self.unobserved[:, 0] = [MAX_PAYLOAD * generator.random() for generator in generators]
        self._flight = Flight(s0, self.unobserved[:, 0], simulator.threads)
        self._ticks = round(simulator.control_step / self._flight.timestep)
        self._noise = None
        if seeds is not None:
            self._noise = Noise(generators, (self._ticks, 4), noise_steps, np.float32)

    def step(self, actions: Floats) -> Floats:
        noise = None if self._noise is None else self._noise.step()
        return self._flight.advance(actions, self._ticks, noise)


def _generator(seed: int, stream: int) -> np.random.Generator:
    """The generator of one of a seed's independent random streams."""
    return np.random.Generator(np.random.Philox(key=int(seed) + (stream << 64)))


def _uniform(seeds: Seeds, stream: int, variables: tuple[Variable, ...]) -> Doubles:
    """One sample of each of V variables for each seed [N], uniform between the bounds, [N, V]."""
    low, high = bounds(variables)
    uniform = np.array([_generator(seed, stream).random(len(variables)) for seed in seeds])
    return low + (high - low) * uniform.reshape(len(seeds), len(variables))
