"""The symmetries of a system, described by the names of its variables.

A symmetry maps a trajectory of the system onto another one that is as probable: turned about a
vertical axis, mirrored, or moved. A description is data. It can be stored with a data set, and
written for logs. `study.data.transformations` samples and applies the transformations.

The symmetries of a system form a group. A transformation of it first mirrors, then turns, then
shifts::

    Symmetries(
        turn=Turn(states=(("x", "y"),), angles=("yaw",), goal=(("target_x", "target_y"),)),
        mirror=Mirror(states=("y", "yaw"), actions=("yaw_rate",), goal=("target_y",)),
        shifts=(Shift(-20.0, 20.0, states=("x",), goal=("target_x",)),),
    )
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from study.common.errors import BadInput, nearest

Names = tuple[str, ...]
Pairs = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Turn:
    """A turn by any angle φ about a vertical axis.

    A pair (a, b) becomes (a cos φ − b sin φ, a sin φ + b cos φ).

    Attributes:
        states: pairs of state variables that are rotated.
        actions: pairs of action variables.
        goal: pairs of goal variables.
        angles: state variables to which φ is added. An angle is not wrapped: a whole trajectory is
            moved by whole turns, so that its first value is within ±π.
        quarter: φ is a multiple of π/2.
        axis: two pairs of `states`. The first axis of the canonical frame points from one to the
            other, so that a network can learn laws without direction (`study.models.unroll.frame`).
            Events in `broken_by` are then forecast as if every turn preserved them.
        broken_by: events of a trajectory (`Simulator.events`) that only quarter turns preserve.
    """

    states: Pairs = ()
    actions: Pairs = ()
    goal: Pairs = ()
    angles: Names = ()
    quarter: bool = False
    axis: Pairs = ()
    broken_by: Names = ()


@dataclass(frozen=True)
class Mirror:
    """A reflection: some variables change their sign.

    Attributes:
        states: state variables that change their sign.
        actions: action variables.
        goal: goal variables.
    """

    states: Names = ()
    actions: Names = ()
    goal: Names = ()


@dataclass(frozen=True)
class Shift:
    """A move: the same amount is added at every step of a trajectory, and to its goal.

    Attributes:
        low: smallest amount, SI units.
        high: largest amount, SI units; the amount is uniform in between.
        states: state variables to which the amount is added.
        goal: goal variables.
    """

    low: float
    high: float
    states: Names = ()
    goal: Names = ()


@dataclass(frozen=True)
class Symmetries:
    """The symmetry group of a system. Without arguments it is the trivial group.

    Attributes:
        turn: turns about a vertical axis.
        mirror: the reflection.
        shifts: moves, independent of each other.
    """

    turn: Turn = Turn()
    mirror: Mirror = Mirror()
    shifts: tuple[Shift, ...] = ()

    def __bool__(self) -> bool:
        """Whether there is a symmetry."""
        return self.turn != Turn() or self.mirror != Mirror() or bool(self.shifts)

    @classmethod
    def from_facts(cls, facts: Mapping[str, Any]) -> "Symmetries":
        """The symmetries in the facts of a data set; the trivial group if the facts have none."""
        return cls.from_json(facts.get("symmetries", {}))

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "Symmetries":
        """The symmetries that `to_json` gave."""
        turn, mirror = values.get("turn", {}), values.get("mirror", {})
        return cls(
            Turn(**{name: _tuples(value) for name, value in turn.items()}),
            Mirror(**{name: _tuples(value) for name, value in mirror.items()}),
            tuple(
                Shift(**{name: _tuples(value) for name, value in shift.items()})
                for shift in values.get("shifts", ())
            ),
        )

    def to_json(self) -> dict[str, Any]:
        """JSON values, by attribute."""
        return asdict(self)

    def check(
        self, subject: str, state: Sequence[str], action: Sequence[str], goal: Sequence[str]
    ) -> None:
        """Check the names.

        Args:
            subject: what has the symmetries, for errors.
            state: names of the state variables.
            action: names of the action variables.
            goal: names of the goal variables.

        Raises:
            BadInput: a variable does not exist or is named twice, or a shift has no range.
        """
        for group, known in (("states", state), ("actions", action), ("goal", goal)):
            for part, names in self._names(group):
                for number, name in enumerate(names):
                    if name not in known:
                        raise BadInput(
                            f"{subject}: {part}.{group} has no variable '{name}'; "
                            f"{nearest(name, known)}"
                        )
                    if name in names[:number]:
                        raise BadInput(
                            f"{subject}: {part}.{group} names '{name}' twice; name it once"
                        )
        self._check_axis(subject)
        for shift in self.shifts:
            if not shift.low < shift.high:
                raise BadInput(
                    f"{subject}: a shift of {', '.join(shift.states)} is between {shift.low} and "
                    f"{shift.high}; give two bounds, the lower one first"
                )

    def _check_axis(self, subject: str) -> None:
        """See `check`."""
        axis, turn = self.turn.axis, self.turn
        if not axis:
            return
        if len(axis) != 2 or axis[0] == axis[1] or not set(axis) <= set(turn.states):
            raise BadInput(
                f"{subject}: turn.axis is {list(axis)}; give two different pairs of turn.states"
            )
        turned = {name for pair in turn.states for name in pair}
        shifted = any(turned & set(shift.states) for shift in self.shifts)
        if turn.angles or turn.actions or turn.quarter or shifted:
            raise BadInput(
                f"{subject}: turn.axis needs a turn of state pairs by any angle, without angles, "
                "actions or shifts of these pairs; leave out turn.axis"
            )

    def _names(self, group: str) -> Iterator[tuple[str, list[str]]]:
        """The part of the description, and the variables that it names."""
        angles = self.turn.angles if group == "states" else ()
        pairs: Pairs = getattr(self.turn, group)
        yield "turn", [name for pair in pairs for name in pair] + list(angles)
        yield "mirror", list(getattr(self.mirror, group))
        for shift in self.shifts:
            if group != "actions":
                yield "shifts", list(getattr(shift, group))


def _tuples(value: Any) -> Any:
    """The value with tuples for lists."""
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value
