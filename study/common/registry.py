"""Registered classes by name: a new environment or model needs no edit elsewhere."""

from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

from study.common.errors import BadInput, nearest

T = TypeVar("T")


class Registry(Generic[T]):
    """Classes by name. An unknown name raises `BadInput` with the nearest known one.

    >>> animals: Registry[type] = Registry("animal")
    >>> @animals.register("cat")
    ... class Cat: ...
    >>> animals["cat"] is Cat
    True
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self._members: dict[str, T] = {}

    def register(self, name: str) -> Callable[[T], T]:
        """Decorator that registers a class under `name`.

        Raises:
            ValueError: another class has that name already.
        """

        def enter(member: T) -> T:
            known = self._members.get(name)
            # The same source may be imported twice, for example as a plugin and by a test.
            if known is not None and getattr(known, "__qualname__", 1) != getattr(
                member, "__qualname__", 2
            ):
                raise ValueError(f"two {self.kind}s are named '{name}'")
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
