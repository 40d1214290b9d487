"""The value of a setting: what its type allows, in one line if something else is given."""

from collections.abc import Mapping, Sequence
from math import isfinite
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin

from study.common.errors import BadInput, nearest, shown

WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a name"}
LISTS = {
    bool: "a list such as [true, false]",
    int: "a list of whole numbers, such as [0, 1]",
    float: "a list of numbers, such as [0.5, 1.0]",
    str: "a list of names, such as [a, b]",
}
FRACTIONS = Mapping[str, float]
"""The type of `grid.levels`, the only setting that is a mapping."""


def is_supported(kind: Any) -> bool:
    """Whether settings can have the type `kind`."""
    plain, _ = _without_none(kind)
    return plain in WORDS or plain == FRACTIONS or _items(plain) in LISTS


def takes_text(kind: Any) -> bool:
    """Whether a setting of the type `kind` is text, so that a flag gives it as it is written."""
    return _without_none(kind)[0] is str


def allowed(kind: Any) -> str:
    """What a setting of the type `kind` must be, in words."""
    plain, may_be_none = _without_none(kind)
    if plain == FRACTIONS:
        return "[low, high] or fractions by name, such as {low: 1.0, tiny: 0.01}"
    words = LISTS[_items(plain)] if _items(plain) else WORDS[plain]
    return f"{words} or null" if may_be_none else words


def check_setting(
    name: str, kind: Any, value: Any, default: Any, metadata: Mapping[str, Any]
) -> Any:
    """The value as the type `kind`, if the setting allows it.

    Args:
        name: dotted name of the setting.
        kind: its type.
        value: from YAML, JSON or code. A whole number may stand for a number, a list for a tuple.
        default: of the setting. Where it is empty, an empty list is allowed.
        metadata: of the field: `low`, `high`, `choices`, `stored`, `added_later`.

    Raises:
        BadInput: names the setting, what was given and what is allowed.
    """
    typed = _typed(name, kind, value)
    if isinstance(typed, tuple):
        if not typed and default != ():
            raise BadInput(f"{name}: got an empty list; give at least one value")
        if len(set(typed)) < len(typed):
            raise BadInput(f"{name}: got {shown(list(typed))}; each value may stand there once")
    if isinstance(typed, Mapping) and not typed:
        raise BadInput(f"{name}: got nothing; it must be {allowed(kind)}")
    items: Sequence[Any] = (typed,)
    if isinstance(typed, tuple | Mapping):
        items = tuple(typed.values()) if isinstance(typed, Mapping) else typed
    for item in items:
        _check_item(name, item, **metadata)
    return typed


def _check_item(
    name: str,
    value: Any,
    low: Any = None,
    high: Any = None,
    choices: tuple[str, ...] = (),
    stored: bool = True,
    added_later: bool = False,
) -> None:
    if value is None:
        return
    if choices and value not in choices:
        raise BadInput(f"{name}: got {shown(value)}; {nearest(str(value), map(str, choices))}")
    if (low is not None and value < low) or (high is not None and value > high):
        bounds = f"at most {high}" if low is None else f"between {low} and {high}"
        bounds = f"at least {low}" if high is None else bounds
        raise BadInput(f"{name}: got {shown(value)}; it must be {bounds}")


def _typed(name: str, kind: Any, value: Any) -> Any:
    plain, may_be_none = _without_none(kind)
    if value is None and may_be_none:
        return None
    item = _items(plain)
    if item and isinstance(value, list | tuple):
        if len(wrong := [each for each in value if not _is(item, each)]):
            raise BadInput(f"{name}: got {shown(wrong[0])} in it; it must be {allowed(kind)}")
        return tuple(float(each) if item is float else each for each in value)
    if plain == FRACTIONS and isinstance(value, Mapping):
        for key, fraction in value.items():
            if not isinstance(key, str) or not _is(float, fraction):
                given = f"{shown(key)}: {shown(fraction)}"
                raise BadInput(f"{name}: got {given} in it; it must be {allowed(kind)}")
        return {key: float(fraction) for key, fraction in value.items()}
    if plain in WORDS and _is(plain, value):
        return float(value) if plain is float else value
    hint = ""
    if plain is str and isinstance(value, bool | int | float):
        hint = f"; in a YAML file, write '{value}' with quotes"
    raise BadInput(f"{name}: got {shown(value)}; it must be {allowed(kind)}{hint}")


def _is(kind: type, value: Any) -> bool:
    """Whether a value is plainly of a type; a whole number is a number, true is not."""
    if kind is float and type(value) in (int, float):
        try:
            return isfinite(value)
        except OverflowError:
            return False
    return type(value) is kind


def _without_none(kind: Any) -> tuple[Any, bool]:
    """A type without `None`, and whether `None` was allowed."""
    if get_origin(kind) not in (UnionType, Union):
        return kind, False
    others = [each for each in get_args(kind) if each is not NoneType]
    return (others[0] if len(others) == 1 else kind), True


def _items(kind: Any) -> Any:
    """The type of the items of ``tuple[T, ...]``; None for other types."""
    arguments = get_args(kind)
    is_list = get_origin(kind) is tuple and len(arguments) == 2 and arguments[1] is Ellipsis
    return arguments[0] if is_list else None
