"""The UAV's policy: fly to the target within the horizon.

A pilot follows a point that moves from the start to the target along a curved path at constant
pace, and then waits at the target. The velocity set-point is the point's velocity plus a share of
the distance to the point.
"""

import numpy as np

from study.common.arrays import Doubles, Floats
from study.data.variables import Variable

POLICY_VARIABLES = (
    Variable("arrival", "1", "time at which the point arrives, share of the horizon", 0.35, 1.0),
    Variable("lateral_bow", "1", "sideways bow of the path, share of its length", -0.2, 0.2),
    Variable("vertical_bow", "m", "upward bow of the path", -6.0, 10.0),
    Variable("heading", "rad", "heading relative to the direction of flight", -np.pi, np.pi),
    Variable("gain", "1/s", "velocity per metre of distance to the point", 0.3, 0.8),
)
"""The random parameters of a pilot, uniform between the bounds."""

TURN_GAIN = 0.8  # 1/s
MAX_SPEED = 8.0  # m/s, level


class Pilot:
    """N pilots, one for each flight.

    Args:
        s0: [N, 17] initial states.
        target: [N, 3] m.
        parameters: [N, 5], values of `POLICY_VARIABLES`.
        duration: duration of the flight in s.
    """

    def __init__(self, s0: Floats, target: Floats, parameters: Doubles, duration: float) -> None:
        arrival, lateral_bow, vertical_bow, self.heading, self.gain = parameters.T
        self.arrival = arrival * duration
        self.start = s0[:, :3].T.astype(np.float64)
        self.chord = target.T - self.start
        sideways = np.stack([-self.chord[1], self.chord[0]]) * lateral_bow
        self.bow = np.stack([*sideways, vertical_bow])

    def command(self, time: float, states: Floats) -> Doubles:
        """Actions [N, 4] at `time` in `states` [N, 17]. Only the level speed is limited."""
        position, yaw = states[:, :3].T.astype(np.float64), states[:, 8].astype(np.float64)
        along = np.minimum(time / self.arrival, 1.0)
        point = self.start + along * self.chord + 4 * along * (1 - along) * self.bow
        pace = np.where(along < 1, 1 / self.arrival, 0.0)
        point_velocity = pace * (self.chord + 4 * (1 - 2 * along) * self.bow)
        velocity = point_velocity + self.gain * (point - position)
        speed = np.sqrt(velocity[0] ** 2 + velocity[1] ** 2)
        velocity[:2] *= MAX_SPEED / np.maximum(speed, MAX_SPEED)
        turn = np.arctan2(self.chord[1], self.chord[0]) + self.heading - yaw
        turn -= 2 * np.pi * np.round(turn / (2 * np.pi))
        return np.stack([*velocity, TURN_GAIN * turn], axis=1)
