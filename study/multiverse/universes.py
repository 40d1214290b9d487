"""The universes of a design: base readings, one change at a time, and a balanced random part.

The random part is a random design that is balanced in blocks of `BLOCK` universes: in each block,
every value of a choice occurs about equally often. It is made so that an extended design keeps most
universes (rendezvous hashing, Thaler and Ravishankar 1998, with a limit on each value):

- A further choice leaves the values of all other choices as they are.
- A further value of a choice replaces the value of that choice in its share of the universes, and
  leaves most others as they are.
- A larger number of universes leaves complete blocks as they are.
- A universe with an excluded combination gets another value for one of the choices in it.
"""

from collections.abc import Iterator

from study.common.errors import BadInput
from study.common.seeds import derive
from study.multiverse.design import Choice, Design, Exclusion, Universe, Values

BLOCK = 12
"""Random universes in a block. It is a multiple of 2, 3 and 4, the usual numbers of values."""


def universes(design: Design) -> list[Universe]:
    """All universes: the base readings, their single changes, then the random ones.

    A reading that occurs twice is one universe, with its first name. A single change that leads to
    an excluded combination is left out.

    Raises:
        BadInput: a base reading is excluded, or rules exclude all values of a choice.
    """
    found: dict[tuple[str, ...], Universe] = {}
    for universe in (*_bases(design), *_single_changes(design), *_random(design)):
        found.setdefault(design.key(universe.values), universe)
    return list(found.values())


def _bases(design: Design) -> Iterator[Universe]:
    for base, values in design.bases.items():
        if rule := design.excluded(values):
            raise BadInput(f"multiverse.bases.{base}: excluded by a rule ({rule.reason})")
        yield Universe(base, base, None, values)


def _single_changes(design: Design) -> Iterator[Universe]:
    for base, values in design.bases.items():
        for choice in design.choices:
            for value in choice.values:
                changed = {**values, choice.name: value}
                if value != values[choice.name] and design.excluded(changed) is None:
                    yield Universe(f"{base}/{choice.name}={value}", base, choice.name, changed)


def _random(design: Design) -> Iterator[Universe]:
    columns = {
        choice.name: balanced_values(choice, design.random, design.seed)
        for choice in design.choices
    }
    for index in range(design.random):
        values = {name: column[index] for name, column in columns.items()}
        yield Universe(f"random-{index:02}", None, None, _allowed(design, values, index))


def balanced_values(choice: Choice, count: int, seed: int) -> list[str]:
    """The value of a choice in each of `count` random universes.

    Every universe prefers the values in the order of a hash. In each block of universes, the
    strongest preferences are served first, and no value is served more than its share, rounded up.
    """
    share = -(-BLOCK // len(choice.values))
    column: dict[int, str] = {}
    for first in range(0, count, BLOCK):
        block = range(first, first + BLOCK)  # a last, incomplete block is cut off below
        served = dict.fromkeys(choice.values, 0)
        pairs = [
            (_preference(seed, choice.name, value, index), index, value)
            for index in block
            for value in choice.values
        ]
        for _, index, value in sorted(pairs, reverse=True):
            if index not in column and served[value] < share:
                column[index] = value
                served[value] += 1
    return [column[index] for index in range(count)]


def _preference(seed: int, choice: str, value: str, index: int) -> int:
    return derive("multiverse", seed, choice, value, index)


def _allowed(design: Design, values: Values, index: int) -> Values:
    """The values, with another one wherever a rule excludes the combination.

    The universe's number and the seed determine which choice of the combination gets another value.
    """
    by_name = {choice.name: choice for choice in design.choices}
    for _ in range(10 * len(design.exclusions) + 1):
        rule = design.excluded(values)
        if rule is None:
            return values
        values = _repaired(design, rule, values, index, by_name)
    raise BadInput("multiverse.exclude: the rules leave no allowed value for a random universe")


def _repaired(
    design: Design, rule: Exclusion, values: Values, index: int, choices: dict[str, Choice]
) -> Values:
    """The values with another value for one choice of an excluded combination."""
    options = [
        (
            # The choice first, so that choices with many values are not changed more often.
            _preference(design.seed, f"instead of {name}", "", index),
            _preference(design.seed, f"instead of {name}", value, index),
            {**values, name: value},
        )
        for name in rule.values
        for value in choices[name].values
        if value != values[name]
    ]
    allowed = [option for option in options if design.excluded(option[2]) is None]
    return max(allowed or options, key=lambda option: option[:2])[2]
