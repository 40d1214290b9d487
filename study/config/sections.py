"""Sections of settings: frozen dataclasses, each with a dotted name in flags and YAML files.

`study.config.settings` has the sections that every study has. Models add those that they read:

- `section` registers a section that several models may share, such as ``vae``.
- A model's own settings are the fields of its `settings_class` that are no sections. When the model
  is registered, `register_own` makes them the section ``model.NAME``.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, Field, field, fields, is_dataclass, make_dataclass
from inspect import cleandoc
from typing import Any, TypeVar, get_type_hints

from study.common.errors import BadInput
from study.common.registry import check_name, full_name
from study.config.values import check_setting, is_supported

T = TypeVar("T")

PREFIX = "model."
"""Begins the section of a model's own settings."""

_registered: dict[str, type[Any]] = {}


def setting(default: Any, **allowed: Any) -> Any:
    """A field of a section, with bounds `low` and `high`, both inclusive, or with `choices`.

    With ``stored=False`` the setting is not written to files, and no task's key depends on it.
    With ``added_later=True`` it was added after studies were published: see
    `study.config.convert.to_json`.
    """
    return field(default=default, metadata=allowed)


def section(name: str) -> Callable[[type[T]], type[T]]:
    """Decorator that registers a frozen dataclass as the section `name`.

    A model reads it if its `settings_class` has a field of that name.
    """

    def enter(settings: type[T]) -> type[T]:
        check_name("section", name, full_name(settings))
        _check(name, settings)
        _registered[name] = settings
        return settings

    return enter


def register_own(model: str, settings_class: type[Any]) -> None:
    """Register the fields of `settings_class` that are no sections, as the section ``model.NAME``.

    Args:
        model: registered name of the model.
        settings_class: of the model.

    Raises:
        BadInput: a setting has no default, or a type that settings cannot have.
    """
    _registered.pop(PREFIX + model, None)
    kinds, sections = get_type_hints(settings_class), sections_of(settings_class)
    own = [entry for entry in fields(settings_class) if entry.name not in sections]
    if not own:
        return
    for entry in own:
        if _default(entry) is MISSING:
            raise BadInput(
                f"{full_name(settings_class)}: the setting '{entry.name}' has no default; write "
                f"{entry.name}: … = setting(DEFAULT)"
            )
    made = make_dataclass(
        settings_class.__name__,
        [(entry.name, kinds[entry.name], _copy(entry)) for entry in own],
        namespace={"__doc__": settings_class.__doc__, "__module__": settings_class.__module__},
        frozen=True,
    )
    _check(PREFIX + model, made)
    _registered[PREFIX + model] = made


def register_systems(names: Iterable[str], settings: type[Any]) -> None:
    """Register the sections of recorded systems (`study.config.recorded`).

    They replace those of a study that was read before, whose names may now mean simulators.

    Args:
        names: of the sections.
        settings: the class of all of them.
    """
    for name in [name for name, kind in _registered.items() if kind is settings]:
        del _registered[name]
    for name in names:
        _check(name, settings)
        _registered[name] = settings


def sections_of(settings_class: type[Any]) -> list[str]:
    """The fields of a model's `settings_class` that are sections."""
    kinds = get_type_hints(settings_class)
    return [entry.name for entry in fields(settings_class) if is_dataclass(kinds[entry.name])]


def registered() -> Mapping[str, type[Any]]:
    """The sections that models registered, by dotted name."""
    return _registered


def descriptions(settings: type[Any]) -> dict[str, str]:
    """What the docstring of a dataclass says about each field."""
    found: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in cleandoc(settings.__doc__ or "").splitlines():
        if begins := re.match(r" {4}(\w+): (.*)", line):
            lines = found.setdefault(begins[1], [])
            line = begins[2]
        elif not line.startswith("     "):
            lines = []
        lines.append(line.strip())
    return {name: " ".join(text) for name, text in found.items()}


def _default(entry: Field[Any]) -> Any:
    return entry.default if entry.default_factory is MISSING else entry.default_factory()


def _copy(entry: Field[Any]) -> Any:
    if entry.default_factory is not MISSING:
        return field(default_factory=entry.default_factory, metadata=entry.metadata)
    return field(default=entry.default, metadata=entry.metadata)


def _check(name: str, settings: type[Any]) -> None:
    """Check the types and the defaults of a section.

    Raises:
        BadInput: one cannot be used.
    """
    kinds = get_type_hints(settings)
    for entry in fields(settings):
        key = f"{name}.{entry.name}"
        if not is_supported(kinds[entry.name]):
            raise BadInput(
                f"{full_name(settings)}: the setting '{entry.name}' has the type {entry.type}; it "
                "must be bool, int, float, str, one of these or None, or a tuple of them"
            )
        check_setting(key, kinds[entry.name], _default(entry), _default(entry), entry.metadata)
