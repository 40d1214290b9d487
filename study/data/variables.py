"""Names, units, meaning and bounds of the numbers in a data set."""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np

from study.common.arrays import Doubles
from study.config.names import markdown


@dataclass(frozen=True)
class Variable:
    """One component of a vector.

    Attributes:
        name: unique within the vector.
        unit: SI unit; ``1`` for a number without one.
        meaning: a noun phrase.
        low: smallest value.
        high: largest value.
    """

    name: str
    unit: str
    meaning: str
    low: float = -np.inf
    high: float = np.inf


@dataclass(frozen=True)
class Constant:
    """A physical constant of a system: its meaning, value and SI unit."""

    meaning: str
    value: float
    unit: str


class System(Protocol):
    """The variables and the horizon of a system. Every simulator has these attributes.

    Attributes:
        state: the D components of the state.
        action: the A components of the action.
        goal: the G components of the goal.
        horizon: largest number of control steps T.
    """

    @property
    def state(self) -> tuple[Variable, ...]: ...
    @property
    def action(self) -> tuple[Variable, ...]: ...
    @property
    def goal(self) -> tuple[Variable, ...]: ...
    @property
    def horizon(self) -> int: ...


def bounds(variables: tuple[Variable, ...]) -> tuple[Doubles, Doubles]:
    """The low and the high bounds of V variables, [V] each."""
    low, high = np.array([(v.low, v.high) for v in variables], np.float64).reshape(-1, 2).T
    return low, high


def to_json(variables: Iterable[Variable]) -> list[dict[str, Any]]:
    """The variables as JSON values; an infinite bound is null, since JSON has no infinity."""

    def finite(bound: float) -> float | None:
        return bound if math.isfinite(bound) else None

    return [asdict(v) | {"low": finite(v.low), "high": finite(v.high)} for v in variables]


def variables_table(variables: Iterable[Variable]) -> str:
    """A Markdown table with a row for each variable."""
    rows = (
        f"| {markdown(v.name)} | {markdown(v.unit)} | {markdown(v.meaning)} "
        f"| {_number(v.low)} | {_number(v.high)} |"
        for v in variables
    )
    return "\n".join(["| name | unit | meaning | low | high |", "|---|---|---|---|---|", *rows])


def constants_table(constants: Iterable[Constant]) -> str:
    """A Markdown table with a row for each constant."""
    rows = (f"| {markdown(c.meaning)} | {c.value:.4g} | {markdown(c.unit)} |" for c in constants)
    return "\n".join(["| constant | value | unit |", "|---|---|---|", *rows])


def _number(bound: float) -> str:
    return f"{bound:.4g}" if math.isfinite(bound) else "–"
