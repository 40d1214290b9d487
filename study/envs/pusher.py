"""The Pusher of section V-A: a two-link arm on a table pushes a ball to a target."""

from pathlib import Path

import mujoco
import numpy as np
from mujoco.batch import Batch

from study.common.arrays import Booleans, Doubles, Floats, Integers
from study.common.seeds import Seeds
from study.envs.noise import Noise
from study.envs.pusher_policy import LINK, Habits, arm_end, torques
from study.envs.registration import register
from study.envs.simulator import Episode, Policy, Scenarios, Simulator, Variable, bounds
from study.envs.swarm import swarm

MODEL = Path(__file__).with_name("pusher.xml")
SWARM = 8
"""Pushers in one MuJoCo world: with more, the solver's matrices outweigh what is shared."""
BEHIND = 0.045
"""m, from the ball's centre to where the arm end must be able to begin a push."""
SCENARIO_STREAM, NOISE_STREAM = 0, 2
"""Keep apart what is drawn from the same seed; 1 is the policy's."""


@register("pusher")
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
    | theta_rate | rad/s | rate of the upper angle | -100 | 100 |
    | cos_gamma | 1 | cosine of the lower angle γ, from the upper arm | -1 | 1 |
    | sin_gamma | 1 | sine of the lower angle γ, from the upper arm | -1 | 1 |
    | gamma_rate | rad/s | rate of the lower angle | -100 | 100 |
    | ball_x | m | ball | -0.26 | 0.26 |
    | ball_y | m | ball | -0.26 | 0.26 |
    | ball_x_rate | m/s | velocity of the ball | -10 | 10 |
    | ball_y_rate | m/s | velocity of the ball | -10 | 10 |

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
    | theta | rad | upper angle | -3.142 | 3.142 |
    | gamma | rad | lower angle, of either sign | 0.6 | 2.4 |
    | ball_distance | m | from the shoulder to the ball | 0.07 | 0.15 |
    | ball_bearing | rad | direction from the shoulder to the ball | -3.142 | 3.142 |
    | target_distance | m | from the shoulder to the target | 0.03 | 0.18 |
    | target_bearing | rad | direction from the shoulder to the target | -3.142 | 3.142 |

    | name | unit | meaning | low | high |
    |---|---|---|---|---|
    | clearance | m | between the axes of peg and ball | 0.05 | inf |
    | travel | m | from the ball to its target | 0.06 | 0.2 |
    | behind | m | from the shoulder to 0.045 m behind the ball | 0.04 | 0.185 |

    Noise: an independent Gaussian torque of standard deviation 0.006 N·m, added to each joint's
    torque at each control step, after the action has been clipped. It is not recorded.

    Termination: after the horizon, 120 control steps of 0.02 s unless told otherwise (four physics
    steps each). The outcome is whether the ball's centre came within 0.04 m of the target at any
    step of the horizon.

    Policy: `pusher_policy` gets behind the ball, by a detour if need be, and pushes it along the
    line to its target. It sees the state at every control step of the noise-free system; the
    torques that it asks for there are recorded, and that plan is executed. Each trajectory has
    habits of its own:

    | name | unit | meaning | low | high |
    |---|---|---|---|---|
    | approach | m/s | highest speed of the arm end on its way to the ball | 0.35 | 0.6 |
    | push | m/s | highest speed of the push | 0.2 | 0.45 |
    | gap | m | left between peg and ball before the push | 0.005 | 0.025 |

    and it aims beside the line by a Gaussian offset of standard deviation 0.001 m, while the arm
    end wanders by a Gaussian velocity of standard deviation 0.03 m/s, correlated by 0.9 from one
    control step to the next.
    """

    name = "pusher"
    title = "Pusher"
    version = 2
    state = (
        Variable("arm_x", "m", "arm end", -0.2, 0.2),
        Variable("arm_y", "m", "arm end", -0.2, 0.2),
        Variable("cos_theta", "1", "cosine of the upper angle θ", -1, 1),
        Variable("sin_theta", "1", "sine of the upper angle θ", -1, 1),
        Variable("theta_rate", "rad/s", "rate of the upper angle", -100, 100),
        Variable("cos_gamma", "1", "cosine of the lower angle γ, from the upper arm", -1, 1),
        Variable("sin_gamma", "1", "sine of the lower angle γ, from the upper arm", -1, 1),
        Variable("gamma_rate", "rad/s", "rate of the lower angle", -100, 100),
        Variable("ball_x", "m", "ball", -0.26, 0.26),
        Variable("ball_y", "m", "ball", -0.26, 0.26),
        Variable("ball_x_rate", "m/s", "velocity of the ball", -10, 10),
        Variable("ball_y_rate", "m/s", "velocity of the ball", -10, 10),
    )
    action = (
        Variable("upper_torque", "N·m", "torque on the shoulder", -0.05, 0.05),
        Variable("lower_torque", "N·m", "torque on the elbow", -0.05, 0.05),
    )
    goal = (
        Variable("target_x", "m", "where the ball should come to", -0.18, 0.18),
        Variable("target_y", "m", "where the ball should come to", -0.18, 0.18),
    )
    scenario_variables = (
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
        Variable("travel", "m", "from the ball to its target", 0.06, 0.2),
        Variable("behind", "m", f"from the shoulder to {BEHIND:g} m behind the ball", 0.04, 0.185),
    )
    plotted = ("arm_x", "theta_rate", "ball_x_rate")
    default_horizon = 120
    control_step = 0.02
    radius = 0.04
    torque_noise = 0.006
    """N·m, standard deviation."""

    # Five draws in eight are admissible: all 32 fail once in about 10¹³ scenarios.
    _draws = 32

    def __init__(self, horizon: int | None = None, threads: int = 1) -> None:
        super().__init__(horizon, threads)
        self.model = mujoco.MjModel.from_xml_path(str(MODEL))
        self.swarm = swarm(MODEL, SWARM)
        self.ball_height = float(self.model.body("ball").pos[2])

    def sample_scenarios(self, seeds: Seeds) -> Scenarios:
        size = (self._draws, len(self.scenario_variables) + 1)
        uniform = np.stack(
            [np.random.default_rng([int(s), SCENARIO_STREAM]).random(size) for s in seeds]
        )
        low, high = bounds(self.scenario_variables)
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
        goal = np.stack([x[chosen], y[chosen]], axis=-1)
        states = observe(positions, np.zeros_like(positions))
        return Scenarios(states.astype(np.float32), goal.astype(np.float32))

    def start(self, s0: Floats, seeds: Seeds | None = None, ahead: int = 1) -> Episode:
        return _Pushes(self, s0, seeds, ahead)

    def policy(self, scenarios: Scenarios, seeds: Seeds) -> Policy:
        """`pusher_policy`, which draws its habits from `seeds` [N]."""
        habits = Habits.draw(seeds, self.horizon)
        target = scenarios.goal.astype(np.float64)
        damping = float(self.model.joint("shoulder").damping[0])
        return lambda t, states: torques(states.astype(np.float64), target, habits, t, damping)

    def position(self, states: Floats) -> Floats:
        return self._on_table(states[..., 8:10])

    def target(self, goal: Floats) -> Floats:
        return self._on_table(goal)

    def scene(self) -> mujoco.MjModel:
        return self.model

    def configuration(self, states: Floats) -> Doubles:
        return mechanics(states)[0]

    def events(self, states: Floats) -> dict[str, Booleans]:
        """How the ball was first hit, by the angle at which it left, and whether it hit a cushion.

        The ball is at rest until the arm touches it.
        """
        moves = (states[..., 10:12] != 0).any(axis=-1)
        hit = moves.any(axis=-1)
        first = np.maximum(moves.argmax(axis=-1), 1)[..., None, None]

        def at(steps: Integers, columns: slice) -> Doubles:
            return np.take_along_axis(states[..., columns], steps, axis=-2)[..., 0, :].astype(float)

        way = at(first, slice(0, 2)) - at(first - 1, slice(0, 2))
        ball = at(first, slice(10, 12))
        across = np.abs(way[..., 0] * ball[..., 1] - way[..., 1] * ball[..., 0])
        along = (way * ball).sum(axis=-1)
        grazes = across > along
        edge = float(self.model.joint("ball_x").range[1])
        return {
            "the ball is hit squarely": hit & ~grazes,
            "the ball is grazed": hit & grazes,
            "the ball is missed": ~hit,
            "the ball runs into a cushion": (np.abs(states[..., 8:10]) > edge).any(axis=(-1, -2)),
        }

    def outcomes(self, states: Floats, goal: Floats) -> dict[str, Booleans]:
        """Also: whether the ball ends at its target, and stays within the arm's reach."""
        from_shoulder = np.linalg.norm(states[..., 8:10], axis=-1)
        return super().outcomes(states, goal) | {
            "ends at the target": self.outcome(states[..., -1:, :], goal),
            "stays within reach": np.asarray((from_shoulder <= 2 * LINK).all(axis=-1)),
        }

    def _on_table(self, points: Floats) -> Floats:
        """The points [..., 2] at the height of the ball's centre, [..., 3]."""
        height = np.full((*points.shape[:-1], 1), self.ball_height, np.float32)
        return np.concatenate([points, height], axis=-1)


class _Pushes(Episode):
    """N Pushers at once; a world of MuJoCo's holds `SWARM` of them."""

    def __init__(self, simulator: Pusher, s0: Floats, seeds: Seeds | None, ahead: int) -> None:
        self.count = len(s0)
        self.unobserved = np.empty((self.count, 0), np.float32)
        model = simulator.model if self.count == 1 else simulator.swarm
        together = model.nq // 4
        self._worlds = (-(-self.count // together), together)
        self._batch = Batch(model, nsim=self._worlds[0], nthread=simulator.threads)
        self._substeps = round(simulator.control_step / model.opt.timestep)
        # Live arrays, [worlds, together, …]: a view of each world's own memory.
        self._positions = self._batch.bind("qpos").reshape(*self._worlds, 4)
        self._rates = self._batch.bind("qvel").reshape(*self._worlds, 4)
        self._torques = self._batch.bind("ctrl").reshape(*self._worlds, 2)
        positions, rates = mechanics(s0)
        self._positions[...], self._rates[...] = self._fill(positions), self._fill(rates)
        self._noise = None
        if seeds is not None:
            generators = [np.random.default_rng([int(seed), NOISE_STREAM]) for seed in seeds]
            self._noise, self._deviation = Noise(generators, (2,), ahead), simulator.torque_noise

    def step(self, actions: Floats) -> Floats:
        torque = actions.astype(np.float64)
        if self._noise is not None:
            torque += self._deviation * self._noise.step()
        self._torques[...] = self._fill(torque)
        self._batch.step(nstep=self._substeps)
        positions, rates = self._positions.reshape(-1, 4), self._rates.reshape(-1, 4)
        return observe(positions[: self.count], rates[: self.count]).astype(np.float32)

    def _fill(self, values: Doubles) -> Doubles:
        """[N, ...] as [worlds, together, ...]: the last is repeated where N does not fill them."""
        rest = self._worlds[0] * self._worlds[1] - self.count
        full = np.concatenate([values, values[-1:].repeat(rest, 0)])
        return full.reshape(*self._worlds, *values.shape[1:])


# Elementwise functions see contiguous rows only: numpy may round the same number another way in a
# strided array, and then a trajectory would depend on the batch around it.


def observe(positions: Doubles, rates: Doubles) -> Doubles:
    """States [..., 12] of MuJoCo's qpos [..., 4] and qvel [..., 4]."""
    theta, gamma, ball_x, ball_y = np.ascontiguousarray(np.moveaxis(positions, -1, 0))
    theta_rate, gamma_rate, ball_x_rate, ball_y_rate = np.moveaxis(rates, -1, 0)
    upper = (np.cos(theta), np.sin(theta), theta_rate)
    lower = (np.cos(gamma), np.sin(gamma), gamma_rate)
    ball = (ball_x, ball_y, ball_x_rate, ball_y_rate)
    return np.stack([*arm_end(theta, gamma), *upper, *lower, *ball], axis=-1)


def mechanics(states: Floats) -> tuple[Doubles, Doubles]:
    """MuJoCo's qpos [..., 4] and qvel [..., 4] of states [..., 12].

    The arm end is not read: the angles say where it is.
    """
    rows = np.ascontiguousarray(np.moveaxis(states, -1, 0)).astype(np.float64)
    _, _, cos_theta, sin_theta, theta_rate, cos_gamma, sin_gamma, gamma_rate, *ball = rows
    theta, gamma = np.arctan2(sin_theta, cos_theta), np.arctan2(sin_gamma, cos_gamma)
    ball_x, ball_y, ball_x_rate, ball_y_rate = ball
    return (
        np.stack([theta, gamma, ball_x, ball_y], axis=-1),
        np.stack([theta_rate, gamma_rate, ball_x_rate, ball_y_rate], axis=-1),
    )
