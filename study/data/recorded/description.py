"""What a recorded system is, from its settings: variables, outcomes and symmetries, all checked."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from study.common.arrays import Array
from study.common.errors import BadInput, nearest, shown
from study.config.recorded import Column, Recorded, columns
from study.data.expressions import Condition, Expression
from study.data.symmetries import Mirror, Shift, Symmetries, Turn
from study.data.variables import Variable

SINE, COSINE = "sin", "cos"
LOG_TIME = "t"
"""In conditions under which rows are left out: seconds since the log began."""


@dataclass(frozen=True)
class Description:
    """A recorded system.

    Args:
        name: of its section.
        settings: the section.
    """

    name: str
    settings: Recorded

    def check(self) -> None:
        """Check all settings that need no log.

        Raises:
            BadInput: names the setting, what was given and what is allowed.
        """
        settings = self.settings
        for group in ("files", "state", "action"):
            if not getattr(settings, group):
                raise BadInput(f"{self.name}.{group}: got an empty list; give at least one value")
        names = [column.name for column in (*self.columns("state"), *self.columns("action"))]
        names += [column.name for column in self.columns("goal")]
        for name in names:
            if names.count(name) > 1:
                raise BadInput(f"{self.name}: two variables are named '{name}'; write NEW = COLUMN")
        self._known("angles", settings.angles, [c.name for c in self.columns("state")])
        state = [variable.name for variable in self.state]
        self._known("plotted", settings.plotted, state)
        self._known("position", settings.position, state)
        if len(settings.position) not in (0, 2, 3):
            raise BadInput(
                f"{self.name}.position: got {len(settings.position)} variables; give two or three"
            )
        if settings.validation + settings.test >= 1:
            raise BadInput(
                f"{self.name}.test: got {settings.test}; validation and test together must be less "
                "than 1"
            )
        if settings.time is not None and settings.interval is not None:
            raise BadInput(
                f"{self.name}.interval: got {settings.interval:g} and a time column "
                f"'{settings.time}'; give one of the two"
            )
        groups = [[v.name for v in group] for group in (self.state, self.action, self.goal)]
        self.symmetries.check(self.name, *groups)
        for pair in self.rotating_pairs:
            self._known("rotating_pairs", pair, state)
        _ = self.conditions, self.exclusions

    def columns(self, group: str) -> tuple[Column, ...]:
        """The columns of a group of variables: state, action or goal."""
        return columns(self.name, self.settings, group)

    @cached_property
    def state(self) -> tuple[Variable, ...]:
        """The state variables; an angle may be replaced by its sine and cosine."""
        variables: list[Variable] = []
        for column in self.columns("state"):
            if column.name in self.settings.angles and self.settings.angles_as == "sine_cosine":
                variables += [
                    Variable(
                        f"{function}_{column.name}", "1", f"{word} of {column.name}", -1.0, 1.0
                    )
                    for function, word in ((SINE, "sine"), (COSINE, "cosine"))
                ]
            elif column.name in self.settings.angles and column.in_degrees:
                variables.append(_variable(replace(column, unit="rad")))
            else:
                variables.append(_variable(column))
        return tuple(variables)

    @cached_property
    def action(self) -> tuple[Variable, ...]:
        """The action variables."""
        return tuple(map(_variable, self.columns("action")))

    @cached_property
    def goal(self) -> tuple[Variable, ...]:
        """The goal variables."""
        return tuple(map(_variable, self.columns("goal")))

    @property
    def unwrapped(self) -> list[int]:
        """The columns of the states that are unwrapped angles."""
        if self.settings.angles_as != "unwrapped":
            return []
        return [i for i, v in enumerate(self.state) if v.name in self.settings.angles]

    @cached_property
    def conditions(self) -> Mapping[str, Condition]:
        """The outcomes by name."""
        known = [*self._names_in_states(), *(variable.name for variable in self.goal)]
        found: dict[str, Condition] = {}
        for text in self.settings.outcomes:
            name, condition = self._named("outcomes", text, "arrives = x > 3 at any step")
            if name in found:
                raise BadInput(f"{self.name}.outcomes: two are named '{name}'; give another name")
            found[name] = Condition.parse(condition, known, f"{self.name}.outcomes: '{name}'")
        return found

    @cached_property
    def exclusions(self) -> tuple[Expression, ...]:
        """The conditions under which rows are left out."""
        groups = ("state", "action", "goal")
        known = [column.name for group in groups for column in self.columns(group)]
        known += [LOG_TIME] * (LOG_TIME not in known)
        return tuple(
            Expression.parse(text, known, f"{self.name}.exclude") for text in self.settings.exclude
        )

    @cached_property
    def rotating_pairs(self) -> tuple[tuple[str, str, str], ...]:
        """See `Simulator.rotating_pairs`."""
        return tuple(
            (a, b, angle)
            for text in self.settings.rotating_pairs
            for a, b, angle in [self._split("rotating_pairs", text, 3)]
        )

    @cached_property
    def symmetries(self) -> Symmetries:
        """The symmetries that the settings name."""
        settings = self.settings
        pairs = [(a, b) for text in settings.turn for a, b in [self._split("turn", text, 2)]]
        of = {
            "states": [variable.name for variable in self.state],
            "actions": [variable.name for variable in self.action],
            "goal": [variable.name for variable in self.goal],
        }
        every = [name for names in of.values() for name in names]
        self._known("turn", [name for pair in pairs for name in pair], every)
        self._known("mirror", settings.mirror, every)
        moved = [self._shift(text) for text in settings.shifts]
        self._known("shifts", [name for names, _ in moved for name in names], every)
        return Symmetries(
            Turn(
                tuple(pair for pair in pairs if pair[0] in of["states"]),
                tuple(pair for pair in pairs if pair[0] in of["actions"]),
                tuple(pair for pair in pairs if pair[0] in of["goal"]),
                settings.turn_angles,
            ),
            Mirror(**{g: _among(settings.mirror, names) for g, names in of.items()}),
            tuple(
                Shift(-amount, amount, _among(names, of["states"]), _among(names, of["goal"]))
                for names, amount in moved
            ),
        )

    def values(self, states: Array, goal: Array) -> dict[str, Array]:
        """Variables [..., T] by name, for outcomes.

        Args:
            states: [..., T, D].
            goal: [..., G]; it broadcasts against the leading axes of `states`.
        """
        found = {variable.name: states[..., i] for i, variable in enumerate(self.state)}
        for name in self.settings.angles:
            if name not in found:
                found[name] = np.arctan2(found[f"{SINE}_{name}"], found[f"{COSINE}_{name}"])
        shape = states.shape[:-1]
        for i, variable in enumerate(self.goal):
            found[variable.name] = np.broadcast_to(goal[..., i, None], shape)
        return found

    def _names_in_states(self) -> list[str]:
        return [*(variable.name for variable in self.state), *self.settings.angles]

    def _named(self, setting: str, text: str, example: str) -> tuple[str, str]:
        """The two parts of ``NAME = REST``."""
        name, equals, rest = (part.strip() for part in text.partition(" = "))
        if not (name and equals and rest):
            raise BadInput(f"{self.name}.{setting}: got {shown(text)}; write {example}")
        return name, rest

    def _shift(self, text: str) -> tuple[list[str], float]:
        """The variables and the largest amount of a shift."""
        names, amount = self._named("shifts", text, "x goal_x = 20")
        try:
            largest = float(amount)
        except ValueError:
            largest = 0.0
        if not 0 < largest < float("inf"):
            raise BadInput(
                f"{self.name}.shifts: got {shown(text)}; the amount must be a positive number"
            )
        return names.split(), largest

    def _split(self, setting: str, text: str, count: int) -> list[str]:
        names = text.split()
        if len(names) != count:
            raise BadInput(f"{self.name}.{setting}: got {shown(text)}; give {count} names")
        return names

    def _known(self, setting: str, names: Iterable[str], known: Sequence[str]) -> None:
        for name in names:
            if name not in known:
                raise BadInput(
                    f"{self.name}.{setting}: no variable '{name}'; {nearest(name, known)}"
                )


def _variable(column: Column) -> Variable:
    meaning = "logged" if column.name == column.column else f"column {column.column}"
    return Variable(column.name, column.unit, meaning)


def _among(names: Iterable[str], group: Sequence[str]) -> tuple[str, ...]:
    return tuple(name for name in names if name in group)
