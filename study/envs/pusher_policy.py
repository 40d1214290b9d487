"""The policy of the Pusher: move behind the ball, on the line to the target, then push.

The policy is a feedback law for a batch of trajectories. Each trajectory has its own parameters,
sampled with its seed, so that the training data vary. Every operation is elementwise, so a
trajectory's plan does not depend on its batch.
"""

from dataclasses import dataclass

import numpy as np

from study.common.arrays import Doubles
from study.common.seeds import Seeds
from study.data.variables import Variable, bounds

POLICY_VARIABLES = (
    Variable("approach", "m/s", "highest speed of the arm end towards the ball", 0.35, 0.6),
    Variable("push", "m/s", "highest speed of the push", 0.2, 0.45),
    Variable("gap", "m", "gap between peg and ball before the push", 0.005, 0.025),
)
"""The uniform policy parameters; `PolicyParameters` has the Gaussian ones, too."""

LINK = 0.1
"""m, length of each of the two links."""
CONTACT = 0.03
"""m, distance between the axes of ball and peg in contact."""

APPROACH_RATE = 8.0
"""1/s: near a waypoint the speed of the arm end is the distance times this rate."""
DETOUR_STEP = np.deg2rad(50)
"""rad, angle to the next waypoint on a circle around the ball."""
DETOUR_RADIUS = 0.055
"""m, radius of this circle."""
FARTHEST = 0.185
"""m, largest distance from the shoulder to a waypoint: less than the stretched arm's length."""
ASIDE = 0.012
"""m, largest distance from the line of the push at which the arm end pushes."""
EASE = 0.015
"""m, distance from the line of the push at which the speed of the push would be zero."""
CORRECTION_RATE = 12.0
"""1/s, rate at which the arm end returns to the line of the push."""
STOPPING_RATE = 4.0
"""1/s: the speed of the push is at most the ball's distance to its target times this rate."""
NEAR = 0.0075
"""m, distance to its target within which the ball is not pushed."""
SINGULARITY = 0.02
"""m, damping of the inverse Jacobian; it has an effect when the arm is stretched or folded."""
RATE_GAIN = 0.02
"""N·m per rad/s, torque for an error of a joint's rate."""


def arm_end(theta: Doubles, gamma: Doubles) -> tuple[Doubles, Doubles]:
    """Coordinates x, y of the arm end in m, from the angles of the upper and lower arm in rad.

    As in Gymnasium's Reacher, gamma is measured from the upper arm: 0 is the stretched arm.
    """
    return (
        LINK * (np.cos(theta) + np.cos(theta + gamma)),
        LINK * (np.sin(theta) + np.sin(theta + gamma)),
    )


@dataclass(frozen=True)
class PolicyParameters:
    """The random parameters of N trajectories.

    Attributes:
        approach: [N] m/s, highest speed of the arm end towards the ball.
        push: [N] m/s, highest speed of the push.
        gap: [N] m, gap between peg and ball before the push.
        offset: [N] m, sideways offset from the line through ball and target.
        wander: [N, T, 2] m/s, exploration: an Ornstein-Uhlenbeck velocity of the arm end.
    """

    approach: Doubles
    push: Doubles
    gap: Doubles
    offset: Doubles
    wander: Doubles

    OFFSET = 0.001
    """m, standard deviation of `offset`."""
    WANDER = 0.03
    """m/s, stationary standard deviation of `wander`."""
    MEMORY = 0.9
    """Correlation of `wander` from one control step to the next."""

    STREAM = 1
    """The policy's random stream; see `study.envs.pusher`."""

    @classmethod
    def sample(cls, seeds: Seeds, horizon: int) -> "PolicyParameters":
        """The parameters of a trajectory of `horizon` control steps for each seed [N]."""
        uniform = np.empty((len(seeds), len(POLICY_VARIABLES)))
        normal = np.empty((len(seeds), 1 + 2 * horizon))
        for row, seed in enumerate(seeds):
            generator = np.random.default_rng([int(seed), cls.STREAM])
            generator.random(out=uniform[row])
            generator.standard_normal(out=normal[row])
        low, high = bounds(POLICY_VARIABLES)
        approach, push, gap = (low + (high - low) * uniform).T
        wander = normal[:, 1:].reshape(-1, horizon, 2)
        for t in range(1, horizon):
            innovation = np.sqrt(1 - cls.MEMORY**2) * wander[:, t]
            wander[:, t] = cls.MEMORY * wander[:, t - 1] + innovation
        return cls(approach, push, gap, cls.OFFSET * normal[:, 0], cls.WANDER * wander)


def torques(
    states: Doubles, target: Doubles, parameters: PolicyParameters, t: int, damping: float
) -> Doubles:
    """Torques on the joints, before clipping.

    Behind the ball and near the line to the target, the arm end pushes. The push slows down as the
    ball comes close to its target, and stops within `NEAR` of it. Elsewhere the arm end moves to
    the next waypoint on a circle around the ball, in the shorter direction.

    Joint rates follow from the damped inverse of the Jacobian (Nakamura and Hanafusa, 1986).
    Torques are proportional to the error of the rates, and compensate the joints' damping.

    Args:
        states: [N, 12].
        target: [N, 2] m.
        parameters: of N trajectories.
        t: control step.
        damping: of a joint, N·m·s/rad.

    Returns:
        [N, 2] N·m
    """
    (x, y, cos_theta, sin_theta, theta_rate, cos_gamma, sin_gamma, gamma_rate, *ball) = (
        np.ascontiguousarray(states.T)
    )
    ball_x, ball_y, ball_x_rate, ball_y_rate = ball

    # Position of the arm end relative to the ball: `ahead` along the line of the push, `aside` to
    # its left.
    distance = np.hypot(target[:, 0] - ball_x, target[:, 1] - ball_y) + 1e-9
    along_x, along_y = (target[:, 0] - ball_x) / distance, (target[:, 1] - ball_y) / distance
    from_ball_x, from_ball_y = x - ball_x, y - ball_y
    ahead = along_x * from_ball_x + along_y * from_ball_y
    aside = along_x * from_ball_y - along_y * from_ball_x - parameters.offset

    # Approach. The bearing is 0 behind the ball and ±π in front of it.
    bearing = np.arctan2(-aside, -ahead)
    bearing = np.copysign(np.maximum(np.abs(bearing) - DETOUR_STEP, 0.0), bearing)
    reach = np.where(bearing == 0, CONTACT + parameters.gap, DETOUR_RADIUS)
    cos, sin = reach * np.cos(bearing), reach * np.sin(bearing)
    waypoint_x = ball_x - cos * along_x + sin * along_y
    waypoint_y = ball_y - sin * along_x - cos * along_y
    inward = np.minimum(1.0, FARTHEST / (np.hypot(waypoint_x, waypoint_y) + 1e-9))
    error_x, error_y = waypoint_x * inward - x, waypoint_y * inward - y
    error = np.hypot(error_x, error_y) + 1e-9
    approach = np.minimum(parameters.approach, APPROACH_RATE * error) / error

    # Push. Sideways, the arm end moves with the ball and returns to the line.
    forward = np.where(distance > NEAR, np.minimum(parameters.push, STOPPING_RATE * distance), 0.0)
    forward *= np.maximum(1.0 - (aside / EASE) ** 2, 0.0)
    left = along_x * ball_y_rate - along_y * ball_x_rate - CORRECTION_RATE * aside

    pushing = (ahead < 0) & (np.abs(aside) < ASIDE)
    desired_x = np.where(pushing, forward * along_x - left * along_y, approach * error_x)
    desired_y = np.where(pushing, forward * along_y + left * along_x, approach * error_y)
    desired_x, desired_y = (
        desired_x + parameters.wander[:, t, 0],
        desired_y + parameters.wander[:, t, 1],
    )

    # The Jacobian J = [[-y, -v], [x, u]]; the rates solve (JᵀJ + λ²) rates = Jᵀ desired.
    u = LINK * (cos_theta * cos_gamma - sin_theta * sin_gamma)
    v = LINK * (sin_theta * cos_gamma + cos_theta * sin_gamma)
    turn_theta, turn_gamma = x * desired_y - y * desired_x, u * desired_y - v * desired_x
    a, b, c = x * x + y * y + SINGULARITY**2, x * u + y * v, LINK**2 + SINGULARITY**2
    theta_desired = (c * turn_theta - b * turn_gamma) / (a * c - b * b)
    gamma_desired = (a * turn_gamma - b * turn_theta) / (a * c - b * b)
    return np.stack(
        [
            RATE_GAIN * (theta_desired - theta_rate) + damping * theta_rate,
            RATE_GAIN * (gamma_desired - gamma_rate) + damping * gamma_rate,
        ],
        axis=1,
    )
