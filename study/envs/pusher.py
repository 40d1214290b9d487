"""The Pusher of section V-A: a two-link arm on a table pushes a ball to a target."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np
from mujoco.rollout import Rollout as Physics

from study.envs.pusher_policy import Habits, arm_end, torques
from study.envs.simulator import (
    Doubles,
    Floats,
    Rollout,
    Scenarios,
    Simulator,
    Variable,
    simulators,
)
from study.seeds import Seeds

MODEL = Path(__file__).with_name("pusher.xml")
BEHIND = 0.045
"""m, from the ball's centre to where the arm end must be able to begin a push."""

# MuJoCo's full physics state is the time, the positions and the rates.
POSITIONS, RATES = slice(1, 5), slice(5, 9)

Advance = Callable[[Doubles, Floats | Doubles], Doubles]


@simulators.register("pusher")
class Pusher(Simulator):
    """A planar two-link arm, like that of Gymnasium's Reacher, pushes a ball to a target.

    The arm (two links of 0.1 m, 1000 kg/m³) turns above a square table. At its end a vertical peg
    (radius 0.01 m) hangs down to the table; it is the only part that can touch the ball, so the
    links pass above. The ball (radius 0.02 m, 0.04 kg) rolls without slipping, which makes it as
    inert as 7/5 of its mass, and slows by viscous damping of 0.12 N·s/m. Contact is frictionless
    and a little elastic; momentum passes both ways, for arm and ball weigh about the same. At the
    table's edge soft cushions throw the ball back, when its centre comes to ±0.24 m.

    Where it differs from the Reacher: joints without an elbow limit, a motor gear of 1, armature
    0.0005 kg·m² and damping 0.005 N·m·s. (The Reacher's gear of 200 and armature of 1 kg·m² would
    make the arm so heavy that the ball could not move it.)

    State:

    | name | unit | meaning | low | high |
    |---|---|---|---|---|
    | arm_x | m | arm end | -0.2 | 0.2 |
    | arm_y | m | arm end | -0.2 | 0.2 |
    | cos_theta | 1 | cosine of the upper angle θ | -1 | 1 |
    | sin_theta | 1 | sine of the upper angle θ | -1 | 1 |
    | theta_rate | rad/s | rate of the upper angle | -inf | inf |
    | cos_gamma | 1 | cosine of the lower angle γ, from the upper arm | -1 | 1 |
    | sin_gamma | 1 | sine of the lower angle γ, from the upper arm | -1 | 1 |
    | gamma_rate | rad/s | rate of the lower angle | -inf | inf |
    | ball_x | m | ball | -0.26 | 0.26 |
    | ball_y | m | ball | -0.26 | 0.26 |
    | ball_x_rate | m/s | velocity of the ball | -inf | inf |
    | ball_y_rate | m/s | velocity of the ball | -inf | inf |

    Action (clipped to its bounds, held for one control step):

    | name | unit | meaning | low | high |
    |---|---|---|---|---|
    | upper_torque | N·m | torque on the shoulder | -0.05 | 0.05 |
    | lower_torque | N·m | torque on the elbow | -0.05 | 0.05 |

    Hidden variables: none.

    Task:

    | name | unit | meaning | low | high |
    |---|---|---|---|---|
    | target_x | m | where the ball should come to | -0.18 | 0.18 |
    | target_y | m | where the ball should come to | -0.18 | 0.18 |

    Start (at rest; each drawn uniformly, then again until the conditions below hold):

    | name | unit | meaning | low | high |
    |---|---|---|---|---|
    | theta | rad | upper angle | -3.14159 | 3.14159 |
    | gamma | rad | lower angle, of either sign | 0.6 | 2.4 |
    | ball_distance | m | from the shoulder to the ball | 0.07 | 0.15 |
    | ball_bearing | rad | direction from the shoulder to the ball | -3.14159 | 3.14159 |
    | target_distance | m | from the shoulder to the target | 0.03 | 0.18 |
    | target_bearing | rad | direction from the shoulder to the target | -3.14159 | 3.14159 |

    | name | unit | meaning | low | high |
    |---|---|---|---|---|
    | clearance | m | between the axes of peg and ball | 0.05 | inf |
    | travel | m | from the ball to its target | 0.04 | 0.2 |
    | behind | m | from the shoulder to 0.045 m behind the ball | 0.04 | 0.185 |

    Noise: an independent Gaussian torque of standard deviation 0.004 N·m, added to each joint's
    torque at each control step, after the action has been clipped. It is not recorded.

    Termination: after the horizon, 120 control steps of 0.02 s unless told otherwise (two physics
    steps each). The outcome is whether the ball's centre came within 0.025 m of the target at any
    step of the horizon.

    The plan is `pusher_policy` in closed loop with the noise-free system, then recorded.
    """

    name = "pusher"
    version = 1
    state = (
        Variable("arm_x", "m", "arm end", -0.2, 0.2),
        Variable("arm_y", "m", "arm end", -0.2, 0.2),
        Variable("cos_theta", "1", "cosine of the upper angle θ", -1, 1),
        Variable("sin_theta", "1", "sine of the upper angle θ", -1, 1),
        Variable("theta_rate", "rad/s", "rate of the upper angle"),
        Variable("cos_gamma", "1", "cosine of the lower angle γ, from the upper arm", -1, 1),
        Variable("sin_gamma", "1", "sine of the lower angle γ, from the upper arm", -1, 1),
        Variable("gamma_rate", "rad/s", "rate of the lower angle"),
        Variable("ball_x", "m", "ball", -0.26, 0.26),
        Variable("ball_y", "m", "ball", -0.26, 0.26),
        Variable("ball_x_rate", "m/s", "velocity of the ball"),
        Variable("ball_y_rate", "m/s", "velocity of the ball"),
    )
    action = (
        Variable("upper_torque", "N·m", "torque on the shoulder", -0.05, 0.05),
        Variable("lower_torque", "N·m", "torque on the elbow", -0.05, 0.05),
    )
    hidden: ClassVar[tuple[Variable, ...]] = ()
    task = (
        Variable("target_x", "m", "where the ball should come to", -0.18, 0.18),
        Variable("target_y", "m", "where the ball should come to", -0.18, 0.18),
    )
    start = (
        Variable("theta", "rad", "upper angle", -np.pi, np.pi),
        Variable("gamma", "rad", "lower angle, of either sign", 0.6, 2.4),
        Variable("ball_distance", "m", "from the shoulder to the ball", 0.07, 0.15),
        Variable("ball_bearing", "rad", "direction from the shoulder to the ball", -np.pi, np.pi),
        Variable("target_distance", "m", "from the shoulder to the target", 0.03, 0.18),
        Variable(
            "target_bearing", "rad", "direction from the shoulder to the target", -np.pi, np.pi
        ),
    )
    conditions = (
        Variable("clearance", "m", "between the axes of peg and ball", 0.05),
        Variable("travel", "m", "from the ball to its target", 0.04, 0.2),
        Variable("behind", "m", f"from the shoulder to {BEHIND:g} m behind the ball", 0.04, 0.185),
    )
    default_horizon = 120
    control_step = 0.02
    radius = 0.025
    torque_noise = 0.004
    """N·m, standard deviation."""

    _scenario_stream, _noise_stream = 0, 2  # stream 1 of a seed is the policy's
    # Five draws in eight are admissible: all 32 fail once in about 10¹³ scenarios.
    _draws = 32
    # Trajectories simulated at a time: few enough that their physics steps stay in the cache.
    _chunk = 256

    def __init__(self, horizon: int | None = None, threads: int = 1) -> None:
        super().__init__(horizon, threads)
        self.model = mujoco.MjModel.from_xml_path(str(MODEL))
        self.substeps = round(self.control_step / self.model.opt.timestep)
        self.ball_height = float(self.model.body("ball").pos[2])

    def draw(self, seeds: Seeds) -> Scenarios:
        size = (self._draws, len(self.start) + 1)
        uniform = np.stack(
            [np.random.default_rng([int(s), self._scenario_stream]).random(size) for s in seeds]
        )
        low, high = np.array([(v.low, v.high) for v in self.start]).T
        drawn = np.ascontiguousarray(np.moveaxis(low + (high - low) * uniform[..., :-1], -1, 0))
        theta, gamma, ball_distance, ball_bearing, target_distance, target_bearing = drawn
        gamma = np.where(uniform[..., -1] < 0.5, -gamma, gamma)
        arm_x, arm_y = arm_end(theta, gamma)
        ball_x, ball_y = ball_distance * np.cos(ball_bearing), ball_distance * np.sin(ball_bearing)
        x, y = target_distance * np.cos(target_bearing), target_distance * np.sin(target_bearing)

        clearance = np.hypot(arm_x - ball_x, arm_y - ball_y)
        travel = np.hypot(x - ball_x, y - ball_y)
        back = BEHIND / travel
        behind = np.hypot(ball_x - back * (x - ball_x), ball_y - back * (y - ball_y))
        admissible = np.ones_like(travel, bool)
        for condition, value in zip(self.conditions, (clearance, travel, behind), strict=True):
            admissible &= (condition.low <= value) & (value <= condition.high)
        chosen = (np.arange(len(seeds)), admissible.argmax(axis=1))

        positions = np.stack([v[chosen] for v in (theta, gamma, ball_x, ball_y)], axis=-1)
        task = np.stack([x[chosen], y[chosen]], axis=-1)
        states = self._observe(positions, np.zeros_like(positions))
        return Scenarios(states.astype(np.float32), task.astype(np.float32))

    def plan(self, scenarios: Scenarios, seeds: Seeds) -> Floats:
        """Actions [N, T, 2] in N·m of `pusher_policy`, which draws its habits from `seeds` [N]."""
        habits = Habits.draw(seeds, self.horizon)
        target = scenarios.task.astype(np.float64)
        damping = float(self.model.joint("shoulder").damping[0])
        actions = np.empty((len(seeds), self.horizon, len(self.action)), np.float32)
        physics = self._physics(scenarios.s0)
        with self._simulation() as advance:
            for t in range(self.horizon):
                states = self._observe(physics[:, POSITIONS], physics[:, RATES])
                # It aims at the middle of the target: within `radius` alone would just count.
                wanted = torques(states, target, habits, t, damping, near=0.3 * self.radius)
                actions[:, t] = self._bounded(wanted)
                physics = advance(physics, actions[:, t : t + 1])[:, -1]
        return actions

    def rollout(self, s0: Floats, actions: Floats, seeds: Seeds, noise: bool = True) -> Rollout:
        count, horizon, size = actions.shape
        states = np.empty((count, horizon + 1, len(self.state)), np.float32)
        states[:, 0] = s0
        with self._simulation() as advance:
            for first in range(0, count, self._chunk):
                some = slice(first, first + self._chunk)
                applied = self._bounded(actions[some]).astype(np.float64)
                if noise:
                    for torque, seed in zip(applied, seeds[some], strict=True):
                        generator = np.random.default_rng([int(seed), self._noise_stream])
                        torque += self.torque_noise * generator.standard_normal((horizon, size))
                physics = advance(self._physics(s0[some]), applied)
                states[some, 1:] = self._observe(physics[..., POSITIONS], physics[..., RATES])
        return Rollout(states, np.empty((count, len(self.hidden)), np.float32))

    def position(self, states: Floats) -> Floats:
        return self._on_table(states[..., 8:10])

    def target(self, task: Floats) -> Floats:
        return self._on_table(task)

    def scene(self) -> mujoco.MjModel:
        return self.model

    def configuration(self, states: Floats) -> Doubles:
        return self._physics(states)[..., POSITIONS]

    def _on_table(self, points: Floats) -> Floats:
        """The points [..., 2] at the height of the ball's centre, [..., 3]."""
        height = np.full((*points.shape[:-1], 1), self.ball_height, np.float32)
        return np.concatenate([points, height], axis=-1)

    def _bounded(self, actions: Floats | Doubles) -> Floats:
        low, high = np.array([(v.low, v.high) for v in self.action], np.float32).T
        return np.clip(actions, low, high).astype(np.float32)

    # Elementwise functions see contiguous rows only: numpy may round the same number another way
    # in a strided array, and then a trajectory would depend on the batch around it.

    def _observe(self, positions: Doubles, rates: Doubles) -> Doubles:
        """States [..., 12] of MuJoCo's qpos [..., 4] and qvel [..., 4]."""
        theta, gamma, ball_x, ball_y = np.ascontiguousarray(np.moveaxis(positions, -1, 0))
        theta_rate, gamma_rate, ball_x_rate, ball_y_rate = np.moveaxis(rates, -1, 0)
        upper = (np.cos(theta), np.sin(theta), theta_rate)
        lower = (np.cos(gamma), np.sin(gamma), gamma_rate)
        ball = (ball_x, ball_y, ball_x_rate, ball_y_rate)
        return np.stack([*arm_end(theta, gamma), *upper, *lower, *ball], axis=-1)

    def _physics(self, states: Floats) -> Doubles:
        """MuJoCo's full physics state [..., 9], at time 0, of states [..., 12].

        The arm end is not read: the angles say where it is.
        """
        rows = np.ascontiguousarray(np.moveaxis(states, -1, 0)).astype(np.float64)
        _, _, cos_theta, sin_theta, theta_rate, cos_gamma, sin_gamma, gamma_rate, *ball = rows
        theta, gamma = np.arctan2(sin_theta, cos_theta), np.arctan2(sin_gamma, cos_gamma)
        ball_x, ball_y, ball_x_rate, ball_y_rate = ball
        positions = (np.zeros_like(theta), theta, gamma, ball_x, ball_y)
        return np.stack([*positions, theta_rate, gamma_rate, ball_x_rate, ball_y_rate], axis=-1)

    @contextmanager
    def _simulation(self) -> Iterator[Advance]:
        """A function from physics states [N, 9] and torques [N, T, 2] to states [N, T, 9]."""
        data = [mujoco.MjData(self.model) for _ in range(max(self.threads, 1))]
        with Physics(nthread=self.threads if self.threads > 1 else 0) as physics:

            def advance(start: Doubles, applied: Floats | Doubles) -> Doubles:
                controls = np.repeat(applied.astype(np.float64), self.substeps, axis=1)
                reached, _ = physics.rollout(self.model, data, start, controls)
                return np.asarray(reached[:, self.substeps - 1 :: self.substeps])

            yield advance
