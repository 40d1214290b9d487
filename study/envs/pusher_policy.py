"""The policy of the Pusher: get behind the ball, on the line to the target, then push through.

It is a plain feedback law, evaluated for a whole batch at once. Each trajectory has habits of its
own (speeds, offset, clearance and a wandering hand), drawn from its seed, so that plans vary enough
to learn from. Every operation is elementwise: a trajectory's plan does not depend on its batch.
"""

from dataclasses import dataclass

import numpy as np

from study.common.arrays import Doubles
from study.common.seeds import Seeds
from study.envs.simulator import Variable, bounds

HABITS = (
    Variable("approach", "m/s", "highest speed of the arm end on its way to the ball", 0.35, 0.6),
    Variable("push", "m/s", "highest speed of the push", 0.2, 0.45),
    Variable("gap", "m", "left between peg and ball before the push", 0.005, 0.025),
)
"""What differs from one trajectory to the next, each uniform; see `Habits` for what else does."""

LINK = 0.1
"""m, length of each of the two links."""
CONTACT = 0.03
"""m, between the axes of ball and peg when they touch."""

APPROACH_RATE = 8.0
"""1/s: near a waypoint the arm end slows down to the distance times this rate."""
DETOUR_STEP = np.deg2rad(50)
"""rad, by which a waypoint lies ahead on the circle around the ball."""
DETOUR_RADIUS = 0.055
"""m, of that circle."""
FARTHEST = 0.185
"""m, from the shoulder to a waypoint, at most: short of the stretched arm."""
ASIDE = 0.012
"""m, from the line of the push, within which the arm end pushes; beyond it starts again."""
EASE = 0.015
"""m, from the line of the push, at which a push would have slowed to nothing."""
CORRECTION_RATE = 12.0
"""1/s, at which the arm end returns to the line of the push."""
STOPPING_RATE = 4.0
"""1/s: near its target the ball is pushed no faster than its distance times this rate."""
NEAR = 0.0075
"""m, from its target within which the ball is pushed no more."""
SINGULARITY = 0.02
"""m, damping of the inverse Jacobian, which matters where the arm is stretched or folded."""
RATE_GAIN = 0.02
"""N·m per rad/s, from the error of a joint's rate to its torque."""


def arm_end(theta: Doubles, gamma: Doubles) -> tuple[Doubles, Doubles]:
    """x, y of the arm end [m] for the angles of upper and lower arm [rad].

    As in Gymnasium's Reacher, gamma is measured from the upper arm: 0 is the stretched arm.
    """
    return (
        LINK * (np.cos(theta) + np.cos(theta + gamma)),
        LINK * (np.sin(theta) + np.sin(theta + gamma)),
    )


@dataclass(frozen=True)
class Habits:
    """How each of N trajectories pushes.

    Attributes:
        approach: [N] m/s, highest speed of the arm end on its way to the ball.
        push: [N] m/s, highest speed of the push.
        gap: [N] m, left between peg and ball before the push.
        offset: [N] m, sideways from the line through ball and target.
        wander: [N, T, 2] m/s, exploration: an Ornstein-Uhlenbeck velocity of the arm end.
    """

    approach: Doubles
    push: Doubles
    gap: Doubles
    offset: Doubles
    wander: Doubles

    OFFSET = 0.001
    """m, standard deviation."""
    WANDER = 0.03
    """m/s, stationary standard deviation."""
    MEMORY = 0.9
    """Correlation of the wandering from one control step to the next."""

    STREAM = 1
    """Keeps these draws apart from the others that are made from the same seed."""

    @classmethod
    def draw(cls, seeds: Seeds, horizon: int) -> "Habits":
        """One trajectory's habits for each seed [N], for T control steps."""
        uniform = np.empty((len(seeds), len(HABITS)))
        normal = np.empty((len(seeds), 1 + 2 * horizon))
        for row, seed in enumerate(seeds):
            generator = np.random.default_rng([int(seed), cls.STREAM])
            generator.random(out=uniform[row])
            generator.standard_normal(out=normal[row])
        low, high = bounds(HABITS)
        approach, push, gap = (low + (high - low) * uniform).T
        wander = normal[:, 1:].reshape(-1, horizon, 2)
        for t in range(1, horizon):
            fresh = np.sqrt(1 - cls.MEMORY**2) * wander[:, t]
            wander[:, t] = cls.MEMORY * wander[:, t - 1] + fresh
        return cls(approach, push, gap, cls.OFFSET * normal[:, 0], cls.WANDER * wander)


def torques(states: Doubles, target: Doubles, habits: Habits, t: int, damping: float) -> Doubles:
    """Torques [N, 2] in N·m, not yet bounded, for states [N, 12] and targets [N, 2] at step t.

    Near the line behind the ball the arm end pushes, slower as the ball nears its target, and not
    at all within `NEAR` of it. Elsewhere it heads for a waypoint on a circle around the ball,
    the shorter way round. Joint rates follow from the damped inverse of the Jacobian (Nakamura and
    Hanafusa, 1986), torques from the error of the rates; `damping` [N·m·s] of the joints is
    compensated.
    """
    (x, y, cos_theta, sin_theta, theta_rate, cos_gamma, sin_gamma, gamma_rate, *ball) = (
        np.ascontiguousarray(states.T)
    )
    ball_x, ball_y, ball_x_rate, ball_y_rate = ball

    # The line of the push, and the arm end as seen from the ball: `ahead` along it, `aside` left.
    distance = np.hypot(target[:, 0] - ball_x, target[:, 1] - ball_y) + 1e-9
    along_x, along_y = (target[:, 0] - ball_x) / distance, (target[:, 1] - ball_y) / distance
    from_ball_x, from_ball_y = x - ball_x, y - ball_y
    ahead = along_x * from_ball_x + along_y * from_ball_y
    aside = along_x * from_ball_y - along_y * from_ball_x - habits.offset

    # Approach: the bearing is 0 right behind the ball and ±π in front of it.
    bearing = np.arctan2(-aside, -ahead)
    bearing = np.copysign(np.maximum(np.abs(bearing) - DETOUR_STEP, 0.0), bearing)
    reach = np.where(bearing == 0, CONTACT + habits.gap, DETOUR_RADIUS)
    cos, sin = reach * np.cos(bearing), reach * np.sin(bearing)
    way_x = ball_x - cos * along_x + sin * along_y
    way_y = ball_y - sin * along_x - cos * along_y
    inward = np.minimum(1.0, FARTHEST / (np.hypot(way_x, way_y) + 1e-9))
    error_x, error_y = way_x * inward - x, way_y * inward - y
    left = np.hypot(error_x, error_y) + 1e-9
    approach = np.minimum(habits.approach, APPROACH_RATE * left) / left

    # Push: sideways the arm end moves with the ball and returns to the line.
    forward = np.where(distance > NEAR, np.minimum(habits.push, STOPPING_RATE * distance), 0.0)
    forward *= np.maximum(1.0 - (aside / EASE) ** 2, 0.0)
    left = along_x * ball_y_rate - along_y * ball_x_rate - CORRECTION_RATE * aside

    pushing = (ahead < 0) & (np.abs(aside) < ASIDE)
    wanted_x = np.where(pushing, forward * along_x - left * along_y, approach * error_x)
    wanted_y = np.where(pushing, forward * along_y + left * along_x, approach * error_y)
    wanted_x, wanted_y = wanted_x + habits.wander[:, t, 0], wanted_y + habits.wander[:, t, 1]

    # The Jacobian J = [[-y, -v], [x, u]]; the rates solve (JᵀJ + λ²) rates = Jᵀ wanted.
    u = LINK * (cos_theta * cos_gamma - sin_theta * sin_gamma)
    v = LINK * (sin_theta * cos_gamma + cos_theta * sin_gamma)
    turn_theta, turn_gamma = x * wanted_y - y * wanted_x, u * wanted_y - v * wanted_x
    a, b, c = x * x + y * y + SINGULARITY**2, x * u + y * v, LINK**2 + SINGULARITY**2
    theta_wanted = (c * turn_theta - b * turn_gamma) / (a * c - b * b)
    gamma_wanted = (a * turn_gamma - b * turn_theta) / (a * c - b * b)
    return np.stack(
        [
            RATE_GAIN * (theta_wanted - theta_rate) + damping * theta_rate,
            RATE_GAIN * (gamma_wanted - gamma_rate) + damping * gamma_rate,
        ],
        axis=1,
    )
