"""Registered classes by name: a new environment or model needs no edit elsewhere."""

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Generic, TypeVar

from study.common.errors import BadInput, nearest

T = TypeVar("T")

LONGEST = 60
"""Characters of a name, at most: names are parts of paths and columns of tables."""
RESERVED = (
    "all",
    "analogues",
    "training_climatology",
    "ensemble",
    "oracle",
    "paper",
    "persistence",
    "study",
)
"""Names with a meaning of their own in settings or in the paths of results."""


class Registry(Generic[T]):
    """Classes by name. An unknown name raises `BadInput` with the nearest known one.

    >>> animals: Registry[type] = Registry("animal")
    >>> @animals.register("cat")
    ... class Cat: ...
    >>> animals["cat"] is Cat
    True

    Args:
        kind: what the classes are, for errors.
        check: called with a class before it is registered; raises `BadInput`.
    """

    def __init__(self, kind: str, check: Callable[[Any], None] | None = None) -> None:
        self.kind, self._check = kind, check
        self._members: dict[str, T] = {}

    def register(self, name: str) -> Callable[[T], T]:
        """Decorator that registers a class under `name`.

        Raises:
            BadInput: the name cannot be used, another class has it, or the class lacks something.
        """

        def enter(member: T) -> T:
            check_name(self.kind, name, full_name(member))
            if self._check is not None:
                self._check(member)
            known = self._members.get(name, member)
            # The same source may be imported twice, for example as a plugin and by a test.
            if identity(known) != identity(member):
                raise BadInput(
                    f"{full_name(member)}: {full_name(known)} is already registered as "
                    f"'{name}'; give another name to this {self.kind}"
                )
            self._members[name] = member
            return member

        return enter

    def __getitem__(self, name: str) -> T:
        if name not in self._members:
            raise BadInput(f"unknown {self.kind} '{name}': {nearest(name, self._members)}")
        return self._members[name]

    def __contains__(self, name: object) -> bool:
        return name in self._members

    def __iter__(self) -> Iterator[str]:
        return iter(self._members)


def check_name(kind: str, name: object, subject: str | None = None) -> None:
    """Check that a name can be part of paths, patterns, tables and settings.

    Args:
        kind: of what it is the name: environment, model, level.
        name: the name.
        subject: begins the error: a class or a setting.

    Raises:
        BadInput: the name cannot be used.
    """
    begin = f"{subject}: " if subject else ""
    shown = name if len(str(name)) <= LONGEST else f"{str(name)[:LONGEST]}…"
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", name):
        allowed = "letters, digits, _ and -, and begins with a letter or digit"
        raise BadInput(f"{begin}'{shown}' cannot name {_a(kind)}; a name has {allowed}")
    if len(name) > LONGEST:
        raise BadInput(f"{begin}'{shown}' has {len(name)} characters; at most {LONGEST}")
    if name.lower() in RESERVED:
        taken = ", ".join(RESERVED)
        raise BadInput(f"{begin}'{name}' cannot name {_a(kind)}; {taken} have another meaning")


def full_name(member: Any) -> str:
    """The module and the name of a class, such as ``my_system.CartPole``."""
    name = getattr(member, "__qualname__", None)
    return f"{member.__module__}.{name}" if name else repr(member)


def identity(member: Any) -> tuple[str, str]:
    """What tells classes apart: their source file, or else their module, and their name."""
    module = getattr(member, "__module__", "")
    file = getattr(sys.modules.get(module), "__file__", None)
    return str(Path(file).resolve()) if file else module, getattr(member, "__qualname__", "")


def missing(member: type, attributes: tuple[str, ...]) -> list[str]:
    """The attributes that a class lacks, and the abstract methods that it does not define."""
    abstract = [
        name
        for name in dir(member)
        if getattr(getattr(member, name, None), "__isabstractmethod__", False)
    ]
    return [name for name in attributes if not hasattr(member, name)] + abstract


def _a(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"
