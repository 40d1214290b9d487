"""All settings as one table, by dotted name, and the `Config` of given values.

Files, flags and stored studies all come this way: a value is used only if it is plainly what its
setting wants (`study.config.values`).
"""

from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, fields
from typing import Any, get_type_hints

from study.common.errors import BadInput, nearest, shown
from study.config.grid import GROUPS, with_groups
from study.config.names import FRACTIONS
from study.config.recorded import Recorded
from study.config.sections import PREFIX, descriptions, registered
from study.config.settings import SECTIONS, Config, Grid
from study.config.validation import check_together
from study.config.values import check_setting

TOP = ""
"""The section of the settings that stand in no section, such as `name`."""


@dataclass(frozen=True)
class Setting:
    """One setting.

    Attributes:
        section: dotted name of its section.
        name: of the field of the section.
        kind: its type.
        default: its default.
        metadata: bounds `low` and `high`, `choices`, `stored` or `added_later`.
    """

    section: str
    name: str
    kind: Any
    default: Any
    metadata: Mapping[str, Any]

    @property
    def is_stored(self) -> bool:
        """Whether files of a study have the setting."""
        return bool(self.metadata.get("stored", True))

    @property
    def was_added_later(self) -> bool:
        """Whether it was added after studies were published, whose files lack it."""
        return bool(self.metadata.get("added_later", False))


def section_classes() -> dict[str, type[Any]]:
    """The dataclass of every section, by dotted name."""
    kinds = get_type_hints(Config)
    return {TOP: Config} | {name: kinds[name] for name in SECTIONS} | dict(registered())


def known_settings() -> dict[str, Setting]:
    """Every setting, by dotted name: ``name``, ``grid.environments``, …"""
    found = {}
    for section, settings in section_classes().items():
        kinds = get_type_hints(settings)
        for entry in fields(settings):
            if section != TOP or entry.name not in (*SECTIONS, "sections"):
                key = f"{section}.{entry.name}" if section else entry.name
                made = entry.default_factory
                default = entry.default if made is MISSING else made()
                kind = kinds[entry.name]
                found[key] = Setting(section, entry.name, kind, default, entry.metadata)
    return found


def keys() -> list[str]:
    """The dotted name of every setting."""
    return list(known_settings())


def help_texts() -> dict[str, str]:
    """What each setting is, by dotted name."""
    texts = {name: descriptions(settings) for name, settings in section_classes().items()}
    known = known_settings()
    return {key: texts[each.section].get(each.name, "") for key, each in known.items()}


def config_of(values: Mapping[str, Any]) -> Config:
    """The checked settings.

    Levels are put in order, the one with the most data first.

    Args:
        values: by dotted name. Settings without one have their defaults.

    Raises:
        BadInput: names the setting, what was given and what is allowed.
    """
    by_section: dict[str, dict[str, Any]] = {name: {} for name in section_classes()}
    for key, each in known_settings().items():
        value = _spelled_out(key, values[key]) if key in values else each.default
        value = check_setting(key, each.kind, value, each.default, each.metadata)
        if key == "grid.levels":
            value = dict(sorted(value.items(), key=lambda level: (-level[1], level[0])))
        by_section[each.section][each.name] = value
    made = {name: kind(**by_section[name]) for name, kind in section_classes().items() if name}
    core = {name: made.pop(name) for name in SECTIONS}
    core["grid"] = with_groups(core["grid"])
    config = Config(**by_section[TOP], **core, sections=made)
    check_together(config)
    return config


def values_of(config: Config) -> dict[str, Any]:
    """The values of a configuration, by dotted name."""
    return {
        key: getattr(config.section(each.section) if each.section else config, each.name)
        for key, each in known_settings().items()
    }


def to_json(config: Config) -> dict[str, Any]:
    """The settings that files store, as sections of JSON.

    Of models' own settings and of recorded systems, those of the grid. A setting that was added
    later is left out at its default, so that the files of a study stay the same.
    """
    nested: dict[str, Any] = {}
    known = known_settings()
    for key, value in values_of(config).items():
        each = known[key]
        is_left_out = each.was_added_later and value == each.default
        if each.is_stored and not is_left_out and _is_used(key, config.grid):
            *path, name = _split(key)
            section = nested
            for part in path:
                section = section.setdefault(part, {})
            section[name] = value
    return nested


def from_json(values: Mapping[str, Any], unknown: Iterable[str] = ()) -> Config:
    """The settings that `to_json` gave and JSON kept.

    Args:
        values: the sections of settings.
        unknown: sections that are not stored; they have their defaults.

    Raises:
        BadInput: a setting is unknown, missing, or has a value that is not allowed.
    """
    given = flatten(values)
    config = config_of(given)
    for key, each in known_settings().items():
        is_expected = each.is_stored and not each.was_added_later and each.section not in unknown
        if key not in given and is_expected and _is_used(key, config.grid):
            raise BadInput(f"the setting '{key}' is missing")
    return config


def flatten(content: Mapping[str, Any], where: str = "") -> dict[str, Any]:
    """Values by dotted name, from sections of settings.

    Args:
        content: the sections.
        where: ends the name of a setting in errors, such as ``in mine.yaml``.

    Raises:
        BadInput: a setting is unknown, or a section is none.
    """
    known = keys()
    flat: dict[str, Any] = {}

    def visit(part: Mapping[str, Any], prefix: str) -> None:
        inside = [key for key in known if key.startswith(prefix)]
        for name, value in part.items():
            key = f"{prefix}{name}"
            deeper = [each for each in inside if each.startswith(f"{key}.")]
            if key in inside:
                flat[key] = value
            elif not deeper:
                raise unknown_setting(key, where)
            elif isinstance(value, Mapping):
                visit(value, f"{key}.")
            else:
                raise BadInput(
                    f"{key}{where}: got {shown(value)}; it must be a section of settings, such as "
                    f"{deeper[0]}"
                )

    visit(content, "")
    return flat


def unknown_setting(key: str, where: str = "") -> BadInput:
    """The error about a name that no setting has, with those that it may stand for."""
    begin = f"unknown setting {shown(key)}{where}"
    known = keys()
    if key.startswith(PREFIX) or key == PREFIX.strip("."):
        own = sorted(name for name in registered() if name.startswith(PREFIX))
        if not any(key.startswith(f"{name}.") for name in own):
            hint = nearest(key, own) if own else "no model has settings of its own"
            return BadInput(f"{begin}: {hint}; plugins lists the modules of your models")
    section, _, last = key.rpartition(".")
    same_ending = [each for each in known if each.rpartition(".")[2] == last]
    siblings = [each for each in known if section and each.startswith(f"{section}.")]
    sections = sorted({each.partition(".")[0] for each in known})
    return BadInput(f"{begin}: {nearest(key, siblings or same_ending or sections)}")


def _is_used(key: str, grid: Grid) -> bool:
    """Whether the setting is none of a model or recorded system that the grid does not have."""
    first, *rest = _split(key)
    if registered().get(first) is Recorded:
        return first in grid.environments
    return not key.startswith(PREFIX) or rest[0] in grid.models


def _split(key: str) -> list[str]:
    return key.split(".")


def _spelled_out(key: str, value: Any) -> Any:
    """The short spellings ``grid.levels: [low, high]`` and ``grid.models: all``."""
    if key == "grid.models" and isinstance(value, str) and value in GROUPS:
        return [value]
    if key == "grid.levels" and isinstance(value, list | tuple):
        if not value:
            raise BadInput(f"{key}: got an empty list; give at least one value")
        names = [str(name) for name in value]
        for name in names:
            if name not in FRACTIONS:
                hint = f"or give its fraction of the data: '{{{name}: 0.5}}'"
                raise BadInput(f"{key}: got {shown(name)}; {nearest(name, FRACTIONS)}; {hint}")
        if len(set(names)) < len(names):
            raise BadInput(f"{key}: got {shown(names)}; each value may stand there once")
        return {name: FRACTIONS[name] for name in names}
    return value
