"""The policy of the Pusher: get behind the ball, on the line from the target, then push through.

It is a plain feedback law, evaluated for a whole batch at once. Each trajectory has habits of its
own (speed, offset, clearance and a wandering hand), drawn from its seed, so that plans vary enough
to learn from. Every operation is elementwise: a trajectory's plan does not depend on its batch.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.seeds import Seeds

Doubles = NDArray[np.float64]

PUSH_NEAR, PUSH_FAR, FOLLOW, EASE = 0.45, 0.3, 0.0, 0.5
LINK = 0.1
"""m, length of each of the two links."""
CONTACT = 0.03
"""m, between the centres of ball (radius 0.02) and peg (0.01) when they touch."""

APPROACH_SPEED = 0.45
"""m/s, of the arm end on its way to the ball."""
APPROACH_RATE = 8.0
"""1/s, how fast the arm end closes the distance to its waypoint."""
CORRECTION_RATE = 12.0
"""1/s, how fast the arm end returns to the line of the push."""
STOPPING_RATE = 4.0
"""1/s, the push slows down as distance to the target times this rate."""
DETOUR_STEP = np.deg2rad(50)
"""rad, of the circle around the ball that each waypoint of a detour advances."""
DETOUR_RADIUS = CONTACT + 0.025
"""m, of that circle."""
RATE_GAIN = 0.02
"""N·m per rad/s, from the error of a joint's rate to its torque."""
SINGULARITY = 0.02
"""m, damping of the inverse Jacobian, which matters where the arm is stretched or folded."""
FARTHEST = 0.185
"""m, from the shoulder to a waypoint, at most: short of the stretched arm."""


def rotate(x: Doubles, y: Doubles, angle: Doubles) -> tuple[Doubles, Doubles]:
    """The plane vector (x, y), turned by `angle` [rad]."""
    cos, sin = np.cos(angle), np.sin(angle)
    return cos * x - sin * y, sin * x + cos * y


def arm_end(theta: Doubles, gamma: Doubles) -> tuple[Doubles, Doubles]:
    """x, y of the arm end [m]; gamma is measured from the upper arm."""
    return (
        LINK * (np.cos(theta) + np.cos(theta + gamma)),
        LINK * (np.sin(theta) + np.sin(theta + gamma)),
    )


@dataclass(frozen=True)
class Habits:
    """How each of N trajectories pushes.

    Attributes:
        speed: [N] m/s, of the push.
        offset: [N] m, sideways from the line through ball and target.
        gap: [N] m, left between peg and ball before the push.
        wander: [N, T, 2] m/s, exploration: an Ornstein-Uhlenbeck velocity of the arm end.
    """

    speed: Doubles
    offset: Doubles
    gap: Doubles
    wander: Doubles

    SPEED = (0.20, 0.40)
    OFFSET = 0.001
    GAP = (0.005, 0.025)
    WANDER = 0.02
    """m/s, stationary standard deviation of the exploration."""
    WANDER_MEMORY = 0.9
    """Of one control step to the next: a correlation time of 0.19 s."""

    @classmethod
    def draw(cls, seeds: Seeds, attempt: int, horizon: int) -> "Habits":
        """Habits of the given attempt, from seeds [N]. The first steps do not depend on T."""
        uniform, normal = np.empty((len(seeds), 2)), np.empty((len(seeds), 1 + 2 * horizon))
        for row, seed in enumerate(seeds):
            generator = np.random.default_rng([int(seed), 1, attempt])
            generator.random(out=uniform[row])
            generator.standard_normal(out=normal[row])
        low, high = np.array([cls.SPEED, cls.GAP]).T
        speed, gap = (low + (high - low) * uniform).T
        wander = normal[:, 1:].reshape(-1, horizon, 2)
        keep = cls.WANDER_MEMORY
        for t in range(1, horizon):
            wander[:, t] = keep * wander[:, t - 1] + np.sqrt(1 - keep**2) * wander[:, t]
        return cls(speed, cls.OFFSET * normal[:, 0], gap, cls.WANDER * wander)


def push(
    states: Doubles, target: Doubles, habits: Habits, t: int, damping: float, radius: float
) -> Doubles:
    """Torques [N, 2] in N·m, before they are bounded, for states [N, 12] and target [N, 2].

    Away from the line behind the ball the arm end moves to a waypoint on a circle around the ball,
    by the shorter way round. On the line it pushes, slower as the ball nears its target, and stops
    within `radius`. The force that corrects the arm end's velocity becomes torques through the
    transposed Jacobian; `damping` [N·m·s] of the joints is compensated.
    """
    (x, y, cos_theta, sin_theta, theta_rate, cos_gamma, sin_gamma, gamma_rate, ball_x, ball_y, vx, vy) = (
        np.ascontiguousarray(states.T)
    )
    to_target_x, to_target_y = target[:, 0] - ball_x, target[:, 1] - ball_y
    distance = np.hypot(to_target_x, to_target_y)
    along_x, along_y = to_target_x / (distance + 1e-9), to_target_y / (distance + 1e-9)

    # The arm end as seen from the ball: `ahead` along the push, `aside` to its left.
    from_ball_x, from_ball_y = x - ball_x, y - ball_y
    ahead = along_x * from_ball_x + along_y * from_ball_y
    aside = along_x * from_ball_y - along_y * from_ball_x - habits.offset

    bearing = np.arctan2(-aside, -ahead)  # 0 right behind the ball, ±π in front of it
    next_bearing = np.copysign(np.maximum(np.abs(bearing) - DETOUR_STEP, 0.0), bearing)
    reach = np.where(next_bearing == 0, CONTACT + habits.gap, DETOUR_RADIUS)
    way_x, way_y = rotate(-along_x * reach, -along_y * reach, next_bearing)
    way_x, way_y = way_x + ball_x, way_y + ball_y
    inward = np.minimum(1.0, FARTHEST / (np.hypot(way_x, way_y) + 1e-9))
    error_x, error_y = way_x * inward - x, way_y * inward - y
    left = np.hypot(error_x, error_y)
    approach = np.minimum(APPROACH_SPEED, APPROACH_RATE * left) / (left + 1e-9)

    forward = np.where(distance > radius, np.minimum(habits.speed, STOPPING_RATE * distance), 0.0)
    back = along_x * vy - along_y * vx - CORRECTION_RATE * aside
    forward = forward * np.maximum(1.0 - (aside / (EASE * CONTACT)) ** 2, 0.0)
    pushing = (ahead < 0) & (np.abs(aside) < np.where(np.hypot(from_ball_x, from_ball_y) < 1.3 * CONTACT, PUSH_NEAR, PUSH_FAR) * CONTACT)
    wanted_x = np.where(pushing, forward * along_x - back * along_y, approach * error_x + FOLLOW * vx)
    wanted_y = np.where(pushing, forward * along_y + back * along_x, approach * error_y + FOLLOW * vy)
    wanted_x, wanted_y = wanted_x + habits.wander[:, t, 0], wanted_y + habits.wander[:, t, 1]

    # The Jacobian's columns are what the arm end does as theta and as gamma turns; its damped
    # inverse gives the rates that the joints need.
    u = LINK * (cos_theta * cos_gamma - sin_theta * sin_gamma)
    v = LINK * (sin_theta * cos_gamma + cos_theta * sin_gamma)
    turn_theta, turn_gamma = x * wanted_y - y * wanted_x, u * wanted_y - v * wanted_x
    a = x * x + y * y + SINGULARITY**2
    b = x * u + y * v
    c = LINK**2 + SINGULARITY**2
    determinant = a * c - b * b
    theta_error = (c * turn_theta - b * turn_gamma) / determinant - theta_rate
    gamma_error = (a * turn_gamma - b * turn_theta) / determinant - gamma_rate
    return np.stack(
        [
            RATE_GAIN * theta_error + damping * theta_rate,
            RATE_GAIN * gamma_error + damping * gamma_rate,
        ],
        axis=1,
    )
