"""Transformations of trajectories by the symmetries of their system, in SI units.

Every transformation is an affine map of the states, of the actions and of the goal. So a batch of
trajectories is transformed by one matrix product.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from study.common.arrays import Booleans, Doubles, Floats, Integers
from study.data.symmetries import Mirror, Symmetries, Turn
from study.data.trajectories import Trajectories

COPIES = 8
"""Transformed copies of a trajectory that stand for its orbit.

An augmented data set counts as so many times its trajectories in the weight decay. With eight
copies of each of 1,000 trajectories, the weight decay of 8,000 gave far better forecasts than that
of 1,000."""
SMALLEST = 1e-15
"""A sine or cosine below it is zero: quarter turns are exact."""
NO_PAIRS: Integers = np.zeros((0, 2), np.int64)

Number = TypeVar("Number", bound=np.floating[Any])


@dataclass(frozen=True)
class AffineMaps:
    """N affine maps v ↦ v A + b of vectors of V components, one for each trajectory.

    Attributes:
        matrix: A, [N, V, V].
        offset: b, [N, V].
    """

    matrix: Doubles
    offset: Doubles

    def __call__(self, values: NDArray[Number]) -> NDArray[Number]:
        """Transform vectors [N, ..., V], in their own precision."""
        count, size = self.offset.shape
        matrix, offset = self.matrix.astype(values.dtype), self.offset.astype(values.dtype)
        transformed: NDArray[Number] = values.reshape(count, -1, size) @ matrix
        transformed += offset[:, None]
        return transformed.reshape(values.shape)


@dataclass(frozen=True)
class Transformations:
    """One transformation for each of N trajectories.

    Attributes:
        states: maps of states and of forecasts.
        actions: maps of actions.
        goal: maps of goals.
    """

    states: AffineMaps
    actions: AffineMaps
    goal: AffineMaps


class _Columns:
    """The columns of one array that the symmetries change."""

    def __init__(self, symmetries: Symmetries, group: str, names: Sequence[str]) -> None:
        turn, mirror = symmetries.turn, symmetries.mirror
        self.size, find = len(names), list(names).index
        pairs = getattr(turn, group)
        self.first = np.array([find(a) for a, _ in pairs], np.intp)
        self.second = np.array([find(b) for _, b in pairs], np.intp)
        self.mirrored = np.array([find(name) for name in getattr(mirror, group)], np.intp)
        self.angles = np.array(
            [find(name) for name in turn.angles] if group == "states" else [], np.intp
        )
        self.shifts = np.zeros((len(symmetries.shifts), self.size))
        for row, shift in zip(self.shifts, symmetries.shifts, strict=True):
            row[[find(name) for name in getattr(shift, group, ())]] = 1.0

    def maps(
        self, angle: Doubles, mirrored: Booleans, shift: Doubles, s0: Floats | None = None
    ) -> AffineMaps:
        """The affine maps; arguments as of `SymmetryGroup.transformations`."""
        signs = np.ones((len(angle), self.size))
        signs[:, self.mirrored] -= 2.0 * mirrored[:, None]
        matrix = np.zeros((len(angle), self.size, self.size))
        diagonal = np.arange(self.size)
        matrix[:, diagonal, diagonal] = 1.0
        offset = shift @ self.shifts
        if len(self.first):
            cos, sin = (_without_rounding(f(angle))[:, None] for f in (np.cos, np.sin))
            first, second = self.first, self.second
            matrix[:, first, first] = matrix[:, second, second] = cos
            matrix[:, first, second], matrix[:, second, first] = sin, -sin
        if len(self.angles) and s0 is not None:
            turned = s0[:, self.angles] * signs[:, self.angles] + angle[:, None]
            whole_turns = 2 * np.pi * np.round(turned / (2 * np.pi))
            offset[:, self.angles] += angle[:, None] - whole_turns
        matrix *= signs[:, :, None]
        return AffineMaps(matrix, offset)


class SymmetryGroup:
    """The symmetries of a system whose variables have columns.

    Args:
        symmetries: of the system.
        state: names of the state variables, by column.
        action: names of the action variables.
        goal: names of the goal variables.
    """

    def __init__(
        self,
        symmetries: Symmetries,
        state: Sequence[str],
        action: Sequence[str],
        goal: Sequence[str],
    ) -> None:
        self.symmetries = symmetries
        self._states = _Columns(symmetries, "states", state)
        self._actions = _Columns(symmetries, "actions", action)
        self._goal = _Columns(symmetries, "goal", goal)
        self._turns = symmetries.turn != Turn()
        self._mirrors = symmetries.mirror != Mirror()

    @classmethod
    def from_facts(cls, facts: Mapping[str, Any]) -> "SymmetryGroup":
        """The group of a data set, from its facts."""
        names = [
            [variable["name"] for variable in facts.get(group, ())]
            for group in ("state", "action", "goal")
        ]
        return cls(Symmetries.from_facts(facts), *names)

    def canonical_frame(self) -> tuple[Integers, Integers]:
        """Columns of the turned pairs [Q, 2] and of the points of the axis [2, 2].

        Both are empty [0, 2] if the symmetries declare no axis.
        """
        if not self.symmetries.turn.axis:
            return NO_PAIRS, NO_PAIRS
        pairs = np.stack([self._states.first, self._states.second], axis=1)
        rows = [self.symmetries.turn.states.index(point) for point in self.symmetries.turn.axis]
        return pairs, pairs[rows]

    def transformations(
        self, s0: Floats, angle: Doubles, mirrored: Booleans, shift: Doubles
    ) -> Transformations:
        """The transformations of N trajectories.

        Args:
            s0: [N, D] initial states, SI units. They decide by how many whole turns an angle moves.
            angle: [N] φ in rad.
            mirrored: [N], whether the trajectory is mirrored.
            shift: [N, P], amount of each of the P shifts, SI units.
        """
        return Transformations(
            self._states.maps(angle, mirrored, shift, s0),
            self._actions.maps(angle, mirrored, shift),
            self._goal.maps(angle, mirrored, shift),
        )

    def sample(self, generator: np.random.Generator, s0: Floats) -> Transformations:
        """A random transformation for each of N trajectories, uniform over the group.

        Args:
            generator: of random numbers.
            s0: [N, D] initial states, SI units.
        """
        angle, mirrored, shift = self._sample(generator, len(s0))
        return self.transformations(s0, angle, mirrored, shift)

    def orbit(self, generator: np.random.Generator, s0: Floats) -> Iterator[Transformations]:
        """`COPIES` transformations of each of N trajectories, spread evenly over the group.

        The angles of one trajectory are evenly spaced, and every other copy is mirrored. So over a
        trajectory's copies a rotated pair has the mean zero, and equal variances.
        """
        angle, mirrored, _ = self._sample(generator, len(s0))
        for copy in range(COPIES):
            turned = copy * (np.pi / 2 if self.symmetries.turn.quarter else 2 * np.pi / COPIES)
            _, _, shift = self._sample(generator, len(s0))
            yield self.transformations(
                s0,
                angle + turned if self._turns else angle,
                mirrored ^ bool(copy % 2) if self._mirrors else mirrored,
                shift,
            )

    def _sample(
        self, generator: np.random.Generator, count: int
    ) -> tuple[Doubles, Booleans, Doubles]:
        """Angles [N], whether mirrored [N], and shifts [N, P]."""
        angle: Doubles = np.zeros(count)
        mirrored: Booleans = np.zeros(count, bool)
        if self._turns and self.symmetries.turn.quarter:
            angle = np.asarray(generator.integers(4, size=count) * (np.pi / 2))
        elif self._turns:
            angle = generator.uniform(-np.pi, np.pi, count)
        if self._mirrors:
            mirrored = generator.random(count) < 0.5
        shifts = self.symmetries.shifts
        low, high = np.array([s.low for s in shifts]), np.array([s.high for s in shifts])
        return angle, mirrored, generator.uniform(low, high, (count, len(shifts)))


def orbit_parts(
    trajectories: Trajectories, group: SymmetryGroup, chunk: int
) -> Iterator[tuple[Floats, Floats]]:
    """States [n, T+1, D] and actions [n, T, A] of `COPIES` copies of each trajectory, by parts.

    The copies are the same at every call.

    Args:
        trajectories: N trajectories in SI units.
        group: their symmetries.
        chunk: number of trajectories in a part.
    """
    for start in range(0, len(trajectories), chunk):
        states = trajectories.states[start : start + chunk]
        actions = trajectories.actions[start : start + chunk]
        for transformed in group.orbit(np.random.default_rng(start), states[:, 0]):
            yield transformed.states(states), transformed.actions(actions)


def _without_rounding(values: Doubles) -> Doubles:
    return np.where(np.abs(values) < SMALLEST, 0.0, values)
