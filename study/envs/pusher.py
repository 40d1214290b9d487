"""The Pusher (paper section IV-A): a two-link arm above a table pushes a ball to a target."""

from pathlib import Path

import mujoco
import numpy as np
from mujoco.batch import Batch

from study.common.arrays import Booleans, Doubles, Floats, Integers
from study.common.seeds import Seeds
from study.data.symmetries import Mirror, Symmetries, Turn
from study.data.variables import Constant, Variable, bounds
from study.envs.noise import Noise
from study.envs.pusher_policy import (
    LINK,
    POLICY_VARIABLES,
    PolicyParameters,
    arm_end,
    torques,
)
from study.envs.registration import register
from study.envs.simulator import Episode, Policy, Scenarios, Simulator
from study.envs.swarm import swarm

MODEL = Path(__file__).with_name("pusher.xml")
SWARM = 8
"""Pushers in one MuJoCo world. With more, the solver's matrices cost more than sharing saves."""
BEHIND = 0.045
"""m, distance from the ball's centre to the point at which a push begins."""
SCENARIO_STREAM, NOISE_STREAM = 0, 2
"""Independent random streams of one seed; stream 1 is the policy's."""
ATTEMPTS = 32
"""Samples of a scenario. Five in eight meet the conditions, so that all 32 fail once in about 10¹³
scenarios."""


@register("pusher")
class Pusher(Simulator):
    """A planar two-link arm, like that of Gymnasium's Reacher, pushes a ball to a target.

    The arm moves above a square table. At its end a vertical peg hangs down to the table. Only the
    peg can touch the ball: the links pass above the ball. The contact is frictionless and slightly
    elastic. The ball also pushes the arm, since the arm and the ball have similar masses.

    The ball rolls without slipping, so its inertia is 7/5 of its mass, and viscous damping slows
    it. Soft cushions at the edge of the table push the ball back.

    The arm differs from the Reacher's in three ways: the elbow has no limit, the motors are weaker,
    and armature and damping are smaller. The Reacher's arm is too heavy to be moved by a ball.

    **Action.** Torques on both joints, clipped to their bounds and held for one control step.

    **Noise.** At each control step an independent Gaussian torque is added to each joint's torque,
    after the action has been clipped. The noise is not recorded.

    **Scenario.** The arm and the ball start at rest. All quantities are sampled uniformly, and
    again until the conditions hold.

    **Outcome.** The ball's centre comes within the goal radius of the target at any step of the
    horizon.

    **Policy.** `pusher_policy` moves the peg behind the ball, around the ball if necessary, and
    pushes the ball along the line to its target. It is planned in closed loop on the noise-free
    system. Each trajectory has its own policy parameters and two Gaussian perturbations: a
    sideways offset from the line, and an autocorrelated velocity of the arm end.
    """

    name = "pusher"
    title = "Pusher"
    version = 2
    state = (
        Variable("arm_x", "m", "position of the arm end, x", -0.2, 0.2),
        Variable("arm_y", "m", "position of the arm end, y", -0.2, 0.2),
        Variable("cos_theta", "1", "cosine of the upper angle θ", -1, 1),
        Variable("sin_theta", "1", "sine of the upper angle θ", -1, 1),
        Variable("theta_rate", "rad/s", "rate of the upper angle", -100, 100),
        Variable("cos_gamma", "1", "cosine of the lower angle γ, relative to the upper arm", -1, 1),
        Variable("sin_gamma", "1", "sine of the lower angle γ, relative to the upper arm", -1, 1),
        Variable("gamma_rate", "rad/s", "rate of the lower angle", -100, 100),
        Variable("ball_x", "m", "position of the ball, x", -0.26, 0.26),
        Variable("ball_y", "m", "position of the ball, y", -0.26, 0.26),
        Variable("ball_x_rate", "m/s", "velocity of the ball, x", -10, 10),
        Variable("ball_y_rate", "m/s", "velocity of the ball, y", -10, 10),
    )
    action = (
        Variable("upper_torque", "N·m", "torque on the shoulder", -0.05, 0.05),
        Variable("lower_torque", "N·m", "torque on the elbow", -0.05, 0.05),
    )
    goal = (
        Variable("target_x", "m", "target of the ball, x", -0.18, 0.18),
        Variable("target_y", "m", "target of the ball, y", -0.18, 0.18),
    )
    scenario_variables = (
        Variable("theta", "rad", "upper angle", -np.pi, np.pi),
        Variable("gamma", "rad", "absolute value of the lower angle", 0.6, 2.4),
        Variable("ball_distance", "m", "distance from the shoulder to the ball", 0.07, 0.15),
        Variable("ball_bearing", "rad", "direction from the shoulder to the ball", -np.pi, np.pi),
        Variable("target_distance", "m", "distance from the shoulder to the target", 0.03, 0.18),
        Variable(
            "target_bearing", "rad", "direction from the shoulder to the target", -np.pi, np.pi
        ),
    )
    scenario_conditions = (
        Variable("clearance", "m", "distance between the axes of peg and ball", 0.05),
        Variable("travel", "m", "distance from the ball to its target", 0.06, 0.2),
        Variable(
            "behind",
            "m",
            f"distance from the shoulder to {BEHIND:g} m behind the ball",
            0.04,
            0.185,
        ),
    )
    policy_variables = POLICY_VARIABLES
    plotted = ("arm_x", "theta_rate", "ball_x_rate")
    symmetries = Symmetries(
        turn=Turn(
            states=(
                ("arm_x", "arm_y"),
                ("cos_theta", "sin_theta"),
                ("ball_x", "ball_y"),
                ("ball_x_rate", "ball_y_rate"),
            ),
            goal=(("target_x", "target_y"),),
            axis=(("arm_x", "arm_y"), ("ball_x", "ball_y")),  # Frictionless contact acts along it.
            broken_by=("the ball reaches a cushion",),  # The table is square.
        ),
        mirror=Mirror(
            states=(
                "arm_y",
                "sin_theta",
                "theta_rate",
                "sin_gamma",
                "gamma_rate",
                "ball_y",
                "ball_y_rate",
            ),
            actions=("upper_torque", "lower_torque"),
            goal=("target_y",),
        ),
    )
    default_horizon = 120
    control_step = 0.02
    radius = 0.04
    torque_noise = 0.006
    """N·m, standard deviation."""

    def __init__(self, horizon: int | None = None, threads: int = 1) -> None:
        super().__init__(horizon, threads)
        self.model = mujoco.MjModel.from_xml_path(str(MODEL))
        self.swarm = swarm(MODEL, SWARM)
        self.ball_height = float(self.model.body("ball").pos[2])

    def sample_scenarios(self, seeds: Seeds) -> Scenarios:
        size = (ATTEMPTS, len(self.scenario_variables) + 1)
        uniform = np.stack(
            [np.random.default_rng([int(s), SCENARIO_STREAM]).random(size) for s in seeds]
        )
        low, high = bounds(self.scenario_variables)
        sampled = np.ascontiguousarray(np.moveaxis(low + (high - low) * uniform[..., :-1], -1, 0))
        theta, gamma, ball_distance, ball_bearing, target_distance, target_bearing = sampled
        gamma = np.where(uniform[..., -1] < 0.5, -gamma, gamma)
        arm_x, arm_y = arm_end(theta, gamma)
        ball_x, ball_y = ball_distance * np.cos(ball_bearing), ball_distance * np.sin(ball_bearing)
        x, y = target_distance * np.cos(target_bearing), target_distance * np.sin(target_bearing)

        clearance = np.hypot(arm_x - ball_x, arm_y - ball_y)
        travel = np.hypot(x - ball_x, y - ball_y)
        back = BEHIND / travel
        behind = np.hypot(ball_x - back * (x - ball_x), ball_y - back * (y - ball_y))
        admissible = np.ones_like(travel, bool)
        for condition, value in zip(
            self.scenario_conditions, (clearance, travel, behind), strict=True
        ):
            admissible &= (condition.low <= value) & (value <= condition.high)
        chosen = (np.arange(len(seeds)), admissible.argmax(axis=1))

        positions = np.stack([v[chosen] for v in (theta, gamma, ball_x, ball_y)], axis=-1)
        goal = np.stack([x[chosen], y[chosen]], axis=-1)
        states = observe(positions, np.zeros_like(positions))
        return Scenarios(states.astype(np.float32), goal.astype(np.float32))

    def start_episode(
        self, s0: Floats, seeds: Seeds | None = None, noise_steps: int = 1
    ) -> Episode:
        return _PusherEpisode(self, s0, seeds, noise_steps)

    def policy(self, scenarios: Scenarios, seeds: Seeds) -> Policy:
        """`pusher_policy`, with parameters that are sampled with `seeds` [N]."""
        parameters = PolicyParameters.sample(seeds, self.horizon)
        target = scenarios.goal.astype(np.float64)
        damping = float(self.model.joint("shoulder").damping[0])
        return lambda t, states: torques(states.astype(np.float64), target, parameters, t, damping)

    def position(self, states: Floats) -> Floats:
        return self._on_table(states[..., 8:10])

    def target(self, goal: Floats) -> Floats:
        return self._on_table(goal)

    def scene(self) -> mujoco.MjModel:
        return self.model

    def configuration(self, states: Floats) -> Doubles:
        return mechanics(states)[0]

    def constants(self) -> tuple[Constant, ...]:
        model = self.model
        peg, ball, slide = model.geom("peg"), model.geom("ball"), model.joint("ball_x")
        shoulder = model.joint("shoulder")
        return (
            Constant("length of each link", LINK, "m"),
            Constant("mass of the upper arm", float(model.body("upper_arm").mass[0]), "kg"),
            Constant(
                "mass of the lower arm with the peg", float(model.body("lower_arm").mass[0]), "kg"
            ),
            Constant("armature of a joint", float(shoulder.armature[0]), "kg·m²"),
            Constant("damping of a joint", float(shoulder.damping[0]), "N·m·s/rad"),
            Constant("radius of the peg", float(peg.size[0]), "m"),
            Constant("radius of the ball", float(ball.size[0]), "m"),
            Constant("mass of the ball", float(model.body("ball").mass[0]), "kg"),
            Constant("damping of the ball", float(slide.damping[0]), "N·s/m"),
            Constant("distance from the centre to each cushion", float(slide.range[1]), "m"),
            Constant("torque noise, standard deviation", self.torque_noise, "N·m"),
            Constant("policy: sideways offset, standard deviation", PolicyParameters.OFFSET, "m"),
            Constant(
                "policy: velocity perturbation, standard deviation", PolicyParameters.WANDER, "m/s"
            ),
            Constant("policy: its correlation between control steps", PolicyParameters.MEMORY, "1"),
        )

    def events(self, states: Floats) -> dict[str, Booleans]:
        """How the first contact moves the ball, and whether the ball reaches a cushion.

        The ball is hit squarely if it leaves within 45° of the peg's direction of motion. It is at
        rest until the peg touches it.
        """
        moves = (states[..., 10:12] != 0).any(axis=-1)
        hit = moves.any(axis=-1)
        first = np.maximum(moves.argmax(axis=-1), 1)[..., None, None]

        def at(steps: Integers, columns: slice) -> Doubles:
            return np.take_along_axis(states[..., columns], steps, axis=-2)[..., 0, :].astype(float)

        peg = at(first, slice(0, 2)) - at(first - 1, slice(0, 2))
        ball = at(first, slice(10, 12))
        across = np.abs(peg[..., 0] * ball[..., 1] - peg[..., 1] * ball[..., 0])
        along = (peg * ball).sum(axis=-1)
        grazes = across > along
        edge = float(self.model.joint("ball_x").range[1])
        return {
            "the ball is hit squarely": hit & ~grazes,
            "the ball is grazed": hit & grazes,
            "the ball is missed": ~hit,
            "the ball reaches a cushion": (np.abs(states[..., 8:10]) > edge).any(axis=(-1, -2)),
        }

    def outcomes(self, states: Floats, goal: Floats) -> dict[str, Booleans]:
        """The goal, whether the ball ends at its target, and whether it stays within reach."""
        from_shoulder = np.linalg.norm(states[..., 8:10], axis=-1)
        return super().outcomes(states, goal) | {
            "ends at the target": self.outcome(states[..., -1:, :], goal),
            "stays within reach": np.asarray((from_shoulder <= 2 * LINK).all(axis=-1)),
        }

    def _on_table(self, points: Floats) -> Floats:
        """The points [..., 2] at the height of the ball's centre, [..., 3]."""
        height = np.full((*points.shape[:-1], 1), self.ball_height, np.float32)
        return np.concatenate([points, height], axis=-1)


class _PusherEpisode(Episode):
    """N Pushers in worlds of `SWARM` Pushers each."""

    def __init__(
        self, simulator: Pusher, s0: Floats, seeds: Seeds | None, noise_steps: int
    ) -> None:
        self.count = len(s0)
        self.unobserved = np.empty((self.count, 0), np.float32)
        model = simulator.model if self.count == 1 else simulator.swarm
        in_world = model.nq // 4
        self._worlds = (-(-self.count // in_world), in_world)
        self._batch = Batch(model, nsim=self._worlds[0], nthread=simulator.threads)
        self._substeps = round(simulator.control_step / model.opt.timestep)
        # Views [worlds, in_world, …] of MuJoCo's own memory.
        self._positions = self._batch.bind("qpos").reshape(*self._worlds, 4)
        self._rates = self._batch.bind("qvel").reshape(*self._worlds, 4)
        self._torques = self._batch.bind("ctrl").reshape(*self._worlds, 2)
        positions, rates = mechanics(s0)
        self._positions[...], self._rates[...] = self._fill(positions), self._fill(rates)
        self._noise = None
        if seeds is not None:
            generators = [np.random.default_rng([int(seed), NOISE_STREAM]) for seed in seeds]
            self._noise = Noise(generators, (2,), noise_steps)
            self._noise_std = simulator.torque_noise

    def step(self, actions: Floats) -> Floats:
        torque = actions.astype(np.float64)
        if self._noise is not None:
            torque += self._noise_std * self._noise.step()
        self._torques[...] = self._fill(torque)
        self._batch.step(nstep=self._substeps)
        positions, rates = self._positions.reshape(-1, 4), self._rates.reshape(-1, 4)
        return observe(positions[: self.count], rates[: self.count]).astype(np.float32)

    def _fill(self, values: Doubles) -> Doubles:
        """Values [N, ...] as [worlds, in_world, ...]; copies of the last one fill the gap."""
        rest = self._worlds[0] * self._worlds[1] - self.count
        full = np.concatenate([values, values[-1:].repeat(rest, 0)])
        return full.reshape(*self._worlds, *values.shape[1:])


# The two functions below work on contiguous rows. NumPy may round an elementwise function
# differently in a strided array, and then a trajectory would depend on its batch.


def observe(positions: Doubles, rates: Doubles) -> Doubles:
    """States [..., 12] from MuJoCo's qpos [..., 4] and qvel [..., 4]."""
    theta, gamma, ball_x, ball_y = np.ascontiguousarray(np.moveaxis(positions, -1, 0))
    theta_rate, gamma_rate, ball_x_rate, ball_y_rate = np.moveaxis(rates, -1, 0)
    upper = (np.cos(theta), np.sin(theta), theta_rate)
    lower = (np.cos(gamma), np.sin(gamma), gamma_rate)
    ball = (ball_x, ball_y, ball_x_rate, ball_y_rate)
    return np.stack([*arm_end(theta, gamma), *upper, *lower, *ball], axis=-1)


def mechanics(states: Floats) -> tuple[Doubles, Doubles]:
    """MuJoCo's qpos [..., 4] and qvel [..., 4] from states [..., 12].

    The position of the arm end is ignored, since it follows from the angles.
    """
    rows = np.ascontiguousarray(np.moveaxis(states, -1, 0)).astype(np.float64)
    _, _, cos_theta, sin_theta, theta_rate, cos_gamma, sin_gamma, gamma_rate, *ball = rows
    theta, gamma = np.arctan2(sin_theta, cos_theta), np.arctan2(sin_gamma, cos_gamma)
    ball_x, ball_y, ball_x_rate, ball_y_rate = ball
    return (
        np.stack([theta, gamma, ball_x, ball_y], axis=-1),
        np.stack([theta_rate, gamma_rate, ball_x_rate, ball_y_rate], axis=-1),
    )
