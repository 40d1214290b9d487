"""The design of a multiverse: choices that the paper leaves open, and the universes to run.

A choice is a question with two or more values. A value is a small set of settings. A universe has
one value of every choice, so it is one reading of the paper.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from study.common.errors import BadInput, shown
from study.config.settings import Config
from study.config.tree import config_of, values_of

RANDOM = "random values"
"""The group of the universes with random values."""
Values = Mapping[str, str]
"""The name of a value for each choice, by the name of the choice."""


@dataclass(frozen=True)
class Choice:
    """One open choice.

    Attributes:
        name: a word, such as `variance`.
        question: the choice in plain words.
        values: settings by dotted name, by the name of the value. The first value is the default of
            a base reading that does not name the choice.
    """

    name: str
    question: str
    values: Mapping[str, Mapping[str, Any]]

    @property
    def default(self) -> str:
        """The first value."""
        return next(iter(self.values))


@dataclass(frozen=True)
class Exclusion:
    """A combination of values that no universe has.

    Attributes:
        values: of some choices.
        reason: why the combination makes no sense.
    """

    values: Values
    reason: str

    def applies(self, values: Values) -> bool:
        """Whether a reading has the combination."""
        return all(values[choice] == value for choice, value in self.values.items())


@dataclass(frozen=True)
class Design:
    """The choices and the universes to run.

    Attributes:
        choices: in the order of tables and figures.
        bases: the base readings by name. Each is changed one choice at a time.
        exclusions: combinations that no universe has.
        random: number of universes with random values.
        seed: of the random universes.
        further_seeds: training seeds of the base readings, beside those of the study. Their scores
            show the variation of training. No verdict takes them into account, so that all
            universes are judged from the same number of seeds.
    """

    choices: tuple[Choice, ...]
    bases: Mapping[str, Values]
    exclusions: tuple[Exclusion, ...] = ()
    random: int = 0
    seed: int = 0
    further_seeds: tuple[int, ...] = ()

    def excluded(self, values: Values) -> Exclusion | None:
        """The first exclusion that applies to a reading; None if it is allowed."""
        return next((rule for rule in self.exclusions if rule.applies(values)), None)

    def key(self, values: Values) -> tuple[str, ...]:
        """The values in the order of the choices, which identify a reading."""
        return tuple(values[choice.name] for choice in self.choices)

    def settings(self, values: Values) -> dict[str, Any]:
        """The settings of a reading that the choices determine, by dotted name."""
        return {
            key: setting
            for choice in self.choices
            for key, setting in choice.values[values[choice.name]].items()
        }


@dataclass(frozen=True)
class Universe:
    """One reading of the paper: a value for every choice.

    Attributes:
        name: `study`, `study/variance=homoscedastic` or `random-03`.
        base: the base reading of which at most one choice is changed; None for a random universe.
        changed: the choice that is changed; None for a base reading and a random universe.
        values: of all choices.
    """

    name: str
    base: str | None
    changed: str | None
    values: Values

    @property
    def kind(self) -> str:
        """How the universe was made: `base`, `one change` or `random`."""
        if self.base is None:
            return "random"
        return "one change" if self.changed else "base"

    @property
    def group(self) -> str:
        """The base reading around which the universe is, or `RANDOM`."""
        return self.base or RANDOM


def check_settings(config: Config, design: Design) -> None:
    """Check that the first value of every choice is that of the settings that universes share.

    So a base reading that names no choice is the study with these settings, and no setting is
    replaced unnoticed.

    Raises:
        BadInput: a setting has another value.
    """
    shared = values_of(config)
    for choice in design.choices:
        for key, value in choice.values[choice.default].items():
            if shared[key] != value:
                raise BadInput(
                    f"{key}: got {shown(shared[key])}, but the choice '{choice.name}' sets it, and "
                    f"its first value '{choice.default}' is {shown(value)}; change "
                    "multiverse.choices in the file of settings"
                )


def config_of_universe(config: Config, design: Design, universe: Universe) -> Config:
    """The settings of a universe. A base reading has the further seeds as well.

    Args:
        config: the settings that all universes share.
        design: the choices.
        universe: the reading.

    Raises:
        BadInput: a value is not allowed for its setting.
    """
    try:
        own = config_of(values_of(config) | design.settings(universe.values))
    except BadInput as error:
        raise BadInput(f"multiverse: universe {universe.name}: {error}") from None
    if universe.kind != "base":
        return own
    seeds = tuple(dict.fromkeys((*own.grid.seeds, *design.further_seeds)))
    return replace(own, grid=replace(own.grid, seeds=seeds))
