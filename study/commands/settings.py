"""Settings from YAML files and flags, checked; every error is one line.

jsonargparse reads the settings and their types. Errors that it would report in several lines, or
not at all, are found before: a line names the setting, what was given, and what is allowed.
"""

import re
import warnings
from argparse import ArgumentError
from collections.abc import Iterable, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import yaml
from jsonargparse import ArgumentParser, Namespace

from study.common.errors import BadInput, nearest
from study.config.grid import GROUPS, with_groups
from study.config.settings import Config, keys
from study.config.validation import check

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
DEFAULT = CONFIGS / "quick.yaml"


def parse_settings(parser: ArgumentParser, arguments: Sequence[str]) -> tuple[Config, Namespace]:
    """Parse a command line that has settings.

    Args:
        parser: has the settings (`add_settings`) and perhaps other arguments.
        arguments: the command line after the command.

    Returns:
        the checked settings, and all values.

    Raises:
        BadInput: a setting is unknown or has a value that is not allowed.
    """
    given = _value(arguments, "--config")
    _check_file(Path(given) if given else DEFAULT)
    if given is None:
        arguments = ["--config", str(DEFAULT), *arguments]
    return _parse(parser, arguments)


def change(config: Config, flags: Sequence[str]) -> Config:
    """Settings with some of them changed.

    Args:
        config: the settings.
        flags: the changes as flags, such as ``--vae.latent_size=2``.

    Raises:
        BadInput: a setting is unknown or has a value that is not allowed.
    """
    check_flags(flags, known_flags())
    parser = ArgumentParser(exit_on_error=False)
    add_settings(parser)
    parser.set_defaults({key: _get(config, key) for key in keys()})
    return _parse(parser, flags)[0]


def add_settings(parser: ArgumentParser) -> None:
    """Add every setting to a parser."""
    parser.add_class_arguments(Config, None)


def known_flags() -> list[str]:
    """The flag of every setting."""
    return [f"--{key}" for key in keys()]


def check_flags(arguments: Sequence[str], known: Iterable[str]) -> None:
    """Check that every flag is known and is followed by a value.

    Raises:
        BadInput: one is not.
    """
    known = [*known, "--help"]
    for position, argument in enumerate(arguments):
        flag, has_value, _ = argument.partition("=")
        if not flag.startswith("--"):
            continue
        if flag not in known:
            raise BadInput(f"unknown setting '{flag[2:]}': {_nearest_key(flag[2:])}")
        following = arguments[position + 1 : position + 2]
        if flag != "--help" and not has_value and (not following or following[0][:2] == "--"):
            raise BadInput(f"{flag[2:]}: its value is missing; write {flag} VALUE")


def parse_arguments(parser: ArgumentParser, arguments: Sequence[str]) -> Namespace:
    """Parse a command line.

    Raises:
        BadInput: it cannot be parsed.
    """
    try:
        return parser.parse_args(list(arguments))
    except ArgumentError as error:
        raise BadInput(_one_line(error)) from None


def _parse(parser: ArgumentParser, arguments: Sequence[str]) -> tuple[Config, Namespace]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        namespace = parse_arguments(parser, _with_lists(arguments))
        values = parser.instantiate(namespace)
    config = Config(**{entry.name: getattr(values, entry.name) for entry in fields(Config)})
    config = replace(config, grid=with_groups(config.grid))
    check(config)
    return config, namespace


def _one_line(error: ArgumentError) -> str:
    """An error of jsonargparse as `tune.trials: got 'abc'; it must be a whole number`."""
    text = " ".join(str(error).split())
    found = re.search(r'Parser key "([\w.]+)".*(?:Got|Given) value: (.*)$', text)
    if not found:
        return text
    name, value = found.groups()
    if name in keys():
        return f"{name}: got '{value}'; it must be {_allowed(name)}"
    # Of the commands' own flags, those that are not text are whole numbers.
    return f"--{name}: got '{value}'; it must be a whole number" if "int" in text else text


def _allowed(name: str) -> str:
    """What the type of a setting allows, in words."""
    section, _, last = name.rpartition(".")
    owner = _get(Config(), section) if section else Config()
    annotation = next(entry.type for entry in fields(owner) if entry.name == last)
    spelled = annotation.__name__ if isinstance(annotation, type) else str(annotation)
    return {
        "bool": "true or false",
        "int": "a whole number",
        "float": "a number",
        "str": "a name",
        "int | None": "a whole number or null",
        "tuple[int, ...]": "a list of whole numbers, such as [0, 1]",
        "tuple[str, ...]": "a list of names, such as [a, b]",
    }[spelled]


def _get(config: Config, key: str) -> Any:
    """The value of the setting, or the section of settings, with a dotted name."""
    value: Any = config
    for name in key.split("."):
        value = getattr(value, name)
    return value


def _nearest_key(name: str) -> str:
    """The settings that an unknown one may stand for. A list of all would be a long line."""
    known = list(keys())
    section, _, last = name.rpartition(".")
    same_ending = [key for key in known if key.rpartition(".")[2] == last]
    siblings = [key for key in known if section and key.startswith(section + ".")]
    sections = sorted({key.partition(".")[0] for key in known})
    return nearest(name, same_ending or siblings or sections)


def _value(arguments: Sequence[str], flag: str) -> str | None:
    """The value of `--flag VALUE` or `--flag=VALUE`; None if the flag is not given."""
    for position, argument in enumerate(arguments):
        if argument == flag and position + 1 < len(arguments):
            return arguments[position + 1]
        if argument.startswith(flag + "="):
            return argument.partition("=")[2]
    return None


def _with_lists(arguments: Sequence[str]) -> list[str]:
    """``--grid.models all`` is short for ``--grid.models '[all]'``."""
    flag, expanded = "--grid.models", list(arguments)
    for position, argument in enumerate(arguments):
        name, equals, value = argument.partition("=")
        if name == flag and value in GROUPS:
            expanded[position] = f"{flag}{equals}[{value}]"
        elif argument in GROUPS and position and arguments[position - 1] == flag:
            expanded[position] = f"[{argument}]"
    return expanded


def _check_file(path: Path) -> None:
    """Check that a file exists, is YAML, and has known settings only."""
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        files = sorted(str(file) for file in path.parent.glob("*.yaml"))
        hint = nearest(str(path), files) if files else f"{path.parent} has no YAML file"
        raise BadInput(f"--config: no file '{path}'; {hint}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"--config: cannot read '{path}': {error}") from None
    except yaml.YAMLError as error:
        where = " ".join(str(error).split())
        raise BadInput(f"--config: '{path}' is not YAML: {where}") from None
    if not isinstance(content, dict):
        raise BadInput(f"--config: '{path}' holds no settings; write lines such as 'name: quick'")
    _check_names(content, Config(), "", path)


def _check_names(content: dict[Any, Any], section: Any, prefix: str, path: Path) -> None:
    names = [entry.name for entry in fields(section)]
    for key, value in content.items():
        name = f"{prefix}{key}"
        if key not in names:
            full = [prefix + known for known in names]
            raise BadInput(f"unknown setting '{name}' in {path}: {nearest(name, full)}")
        default = getattr(section, key)
        if is_dataclass(default):
            if not isinstance(value, dict):
                raise BadInput(
                    f"{name} in {path}: got '{value}'; it must be a section of settings, "
                    f"such as {next(iter(keys(type(default))))}"
                )
            _check_names(value, default, f"{name}.", path)
