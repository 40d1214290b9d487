"""Settings to JSON and back."""

from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from types import UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from study.common.errors import BadInput

T = TypeVar("T")


def to_json(settings: Any) -> dict[str, Any]:
    """A frozen dataclass of settings as nested mappings, for keys, manifests and files of weights.

    A setting that is not stored is left out, and a setting that was added later is left out at its
    default. So the keys of earlier studies stay valid, and `from_json` reads their files.

    Args:
        settings: the dataclass; its fields may be dataclasses.
    """
    values: dict[str, Any] = asdict(settings)
    for entry in fields(settings):
        value = getattr(settings, entry.name)
        is_default = entry.metadata.get("added_later", False) and value == entry.default
        if is_default or not entry.metadata.get("stored", True):
            del values[entry.name]
        elif is_dataclass(value):
            values[entry.name] = to_json(value)
    return values


def from_json(kind: type[T], values: Mapping[str, Any]) -> T:
    """A frozen dataclass of settings from what `to_json` gave.

    A setting without a value has its default.

    Args:
        kind: the dataclass; its fields may be dataclasses.
        values: by the name of the field.

    Raises:
        BadInput: a value has a name that the dataclass does not have.
    """
    known = get_type_hints(kind)
    names = [entry.name for entry in fields(kind)]  # type: ignore[arg-type]
    if unknown := [name for name in values if name not in names]:
        raise BadInput(f"unknown setting '{unknown[0]}' of {kind.__name__}")
    return kind(**{name: _convert(known[name], value) for name, value in values.items()})


def _convert(annotation: Any, value: Any) -> Any:
    """JSON has lists for tuples and mappings for dataclasses."""
    if isinstance(annotation, UnionType):
        if value is None:
            return None
        annotation = next(a for a in get_args(annotation) if a is not type(None))
    if is_dataclass(annotation) and isinstance(annotation, type):
        return from_json(annotation, value)
    return tuple(value) if get_origin(annotation) is tuple else value


def by_dotted_name(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mappings of settings as one, by dotted name such as ``tune.trials``."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        name = f"{prefix}{key}"
        nested = isinstance(value, Mapping)
        flat |= by_dotted_name(value, f"{name}.") if nested else {name: value}
    return flat
