"""The UAV's policy: fly to the target in time, each flight in its own manner.

A pilot follows a point that moves from the start to the target along a bowed path at a steady pace
and then waits there. The command is the point's velocity plus a share of the distance to it. Used
closed loop on the nominal system, so that it makes up for the mean wind but not for the gusts.
"""

import numpy as np

from study.common.arrays import Doubles, Floats
from study.envs.simulator import Variable

HABITS = (
    Variable("arrival", "1", "when the target is reached, as a share of the horizon", 0.35, 1.0),
    Variable("detour", "1", "sideways bow of the path, as a share of its length", -0.2, 0.2),
    Variable("climb", "m", "upward bow of the path", -6.0, 10.0),
    Variable("gaze", "rad", "heading, from the direction of flight", -np.pi, np.pi),
    Variable("zeal", "1/s", "velocity per metre behind the moving point", 0.3, 0.8),
)
"""What differs from flight to flight: each is uniform between its bounds."""

TURN_GAIN = 0.8  # 1/s
MAX_SPEED = 8.0  # m/s, level


class Pilot:
    """N pilots, one for each flight.

    Args:
        s0: [N, 17].
        target: [N, 3] m.
        habits: [N, len(HABITS)], in the units of `HABITS`.
        duration: of the flight, in s.
    """

    def __init__(self, s0: Floats, target: Floats, habits: Doubles, duration: float) -> None:
        arrival, detour, climb, self.gaze, self.zeal = habits.T
        self.arrival = arrival * duration
        self.start = s0[:, :3].T.astype(np.float64)
        self.chord = target.T - self.start
        sideways = np.stack([-self.chord[1], self.chord[0]]) * detour
        self.bow = np.stack([*sideways, climb])

    def command(self, time: float, states: Floats) -> Doubles:
        """Actions [N, 4] at `time` in `states` [N, 17]; only the level speed is limited."""
        position, yaw = states[:, :3].T.astype(np.float64), states[:, 8].astype(np.float64)
        along = np.minimum(time / self.arrival, 1.0)
        point = self.start + along * self.chord + 4 * along * (1 - along) * self.bow
        pace = np.where(along < 1, 1 / self.arrival, 0.0)
        moving = pace * (self.chord + 4 * (1 - 2 * along) * self.bow)
        velocity = moving + self.zeal * (point - position)
        speed = np.sqrt(velocity[0] ** 2 + velocity[1] ** 2)
        velocity[:2] *= MAX_SPEED / np.maximum(speed, MAX_SPEED)
        turn = np.arctan2(self.chord[1], self.chord[0]) + self.gaze - yaw
        turn -= 2 * np.pi * np.round(turn / (2 * np.pi))
        return np.stack([*velocity, TURN_GAIN * turn], axis=1)
