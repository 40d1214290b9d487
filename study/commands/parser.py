"""From the command line and a YAML file to a checked `Config`, or to one clear line.

jsonargparse reads and types the settings; what it would say in several lines, or not at all, is
looked at first, so that every error names the setting, what was given and what is allowed.
"""

import re
import shlex
import warnings
from argparse import ArgumentError, RawDescriptionHelpFormatter
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import yaml
from jsonargparse import ArgumentParser, DefaultHelpFormatter

from study.commands.help import COMMANDS, EPILOG, OWN, STORED, usage
from study.common.errors import BadInput, nearest
from study.config.grid import GROUPS, with_groups
from study.config.settings import Config, keys
from study.config.validation import check
from study.results import folder

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


@dataclass(frozen=True)
class Command:
    """What the user asked for."""

    command: str
    config: Config
    out: Path
    only: str | None = None
    cell: str | None = None
    kind: str = "forecast"
    save: str | None = None
    cells: Sequence[str] = ()
    environment: str | None = None
    to: str | None = None
    scenario: int | None = None
    file: str | None = None
    samples: int | None = None
    write: str | None = None
    rerun: str | None = None
    folders: Sequence[str] = ()
    variants: dict[str, Config] = field(default_factory=dict)
    """The settings of `ablate`, by what was changed: nothing first."""


def parse(arguments: list[str]) -> Command:
    """Read a command line (without the program's name).

    Raises:
        BadInput: anything that cannot be used, in one line.
        SystemExit: after printing help.
    """
    if not arguments:
        raise BadInput(f"a command is missing; {nearest('', COMMANDS)}; try --help")
    command, *rest = arguments
    if command in ("-h", "--help"):
        print(usage())
        raise SystemExit(0)
    if command.startswith("-"):
        raise BadInput(
            f"'{command}' stands before the command; write: python -m study.run all {command} …"
        )
    if command not in COMMANDS:
        raise BadInput(f"unknown command '{command}': {nearest(command, COMMANDS)}")
    parser = _parser(command)
    _check_flags(command, rest)
    if command in STORED:
        namespace = _arguments(parser, rest)
        own = {_name(name): getattr(namespace, _name(name)) for name in OWN[command]}
        out = Path(own.pop("out"))
        read_from = Path(own["folders"][0]) if command == "join" else out
        return Command(command, folder.read(read_from).config, out, **own)
    given = _flag(rest, "--config")
    _check_file(Path(given) if given else CONFIGS / "quick.yaml")
    if given is None:
        rest = ["--config", str(CONFIGS / "quick.yaml"), *rest]
    config, namespace = _settings(parser, rest)
    out = Path(namespace.out) if namespace.out else Path("results") / config.name
    own = {_name(name): getattr(namespace, _name(name)) for name in OWN.get(command, ())}
    if command == "ablate":
        own["variants"] = _variants(parser, rest, config)
    return Command(command, config, out, namespace.only, **own)


def _settings(parser: ArgumentParser, arguments: list[str]) -> tuple[Config, Any]:
    """The checked settings, and what else was given."""
    config, namespace = _read(parser, _with_lists(arguments))
    config = replace(config, grid=with_groups(config.grid))
    check(config)
    return config, namespace


def _variants(parser: ArgumentParser, arguments: list[str], config: Config) -> dict[str, Config]:
    """The settings as they are, and with each change of `ablations`, which is written as a flag.

    Raises:
        BadInput: there is none, or one cannot be.
    """
    if not config.ablations:
        raise BadInput(
            "ablations: nothing to change; --config configs/ablations.yaml has a list, or "
            "--ablations '[vae.decoder_output=mean]'"
        )
    variants = {"": config}
    for change in config.ablations:
        flags = [f"--{word}" for word in shlex.split(change)]
        try:
            _check_flags("ablate", flags)
            variants[change], _ = _settings(parser, arguments + flags)
        except BadInput as error:
            raise BadInput(f"ablations: '{change}': {error}") from None
    return variants


def _parser(command: str) -> ArgumentParser:
    parser = ArgumentParser(
        prog=f"python -m study.run {command}",
        description=COMMANDS[command],
        epilog=EPILOG.get(command),
        formatter_class=RawDescriptionHelpFormatter if command in STORED else DefaultHelpFormatter,
        exit_on_error=False,
    )
    for name, meaning in OWN.get(command, {}).items():
        parser.add_argument(name, **meaning)
    if command in STORED:
        return parser
    parser.add_argument(
        "--config", action="config", help="YAML file; configs/quick.yaml by default"
    )
    parser.add_argument("--out", help="results folder; results/NAME by default")
    parser.add_argument("--only", help="cells whose name matches, such as 'pusher/high/*'")
    parser.add_class_arguments(Config, None)
    return parser


def _name(argument: str) -> str:
    return argument.strip("-")


def _arguments(parser: ArgumentParser, arguments: list[str]) -> Any:
    try:
        return parser.parse_args(arguments)
    except ArgumentError as error:
        raise BadInput(_one_line(error)) from None


def _read(parser: ArgumentParser, arguments: list[str]) -> tuple[Config, Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        namespace = _arguments(parser, arguments)
        built = parser.instantiate(namespace)
    return Config(**{entry.name: getattr(built, entry.name) for entry in fields(Config)}), namespace


def _one_line(error: ArgumentError) -> str:
    """`tune.trials: got 'abc'; it must be a whole number`."""
    text = " ".join(str(error).split())
    found = re.search(r'Parser key "([\w.]+)".*(?:Got|Given) value: (.*)$', text)
    if not found:
        return text
    name, value = found.groups()
    if "int" in text and any(f"--{name}" in own for own in OWN.values()):
        return f"--{name}: got '{value}'; it must be a whole number"
    if name not in keys():
        return text
    return f"{name}: got '{value}'; it must be {_kind(name)}"


def _kind(name: str) -> str:
    """What a setting's type allows, in words."""
    owner: Any = Config()
    *path, last = name.split(".")
    for step in path:
        owner = getattr(owner, step)
    annotation = next(entry.type for entry in fields(owner) if entry.name == last)
    return {
        "bool": "true or false",
        "int": "a whole number",
        "float": "a number",
        "str": "a name",
        "int | None": "a whole number or null",
        "tuple[int, ...]": "a list of whole numbers, such as [0, 1]",
        "tuple[str, ...]": "a list of names, such as [a, b]",
    }[annotation if isinstance(annotation, str) else _spell(annotation)]


def _spell(annotation: Any) -> str:
    return annotation.__name__ if isinstance(annotation, type) else str(annotation)


def _check_flags(command: str, arguments: list[str]) -> None:
    """Every flag is one that the command knows, and stands before a value."""
    own = [name for name in OWN.get(command, ()) if name.startswith("--")]
    known = ["--help", *own]
    if command not in STORED:
        known += ["--config", "--out", "--only", *(f"--{key}" for key in keys())]
    for position, argument in enumerate(arguments):
        flag, has_value, _ = argument.partition("=")
        if not flag.startswith("--"):
            continue
        if flag not in known:
            if command in STORED:
                raise BadInput(f"{command} has no '{flag}': {nearest(flag, own)}")
            raise BadInput(f"unknown setting '{flag[2:]}': {_nearest_key(flag[2:])}")
        following = arguments[position + 1 : position + 2]
        if flag != "--help" and not has_value and (not following or following[0][:2] == "--"):
            raise BadInput(f"{flag[2:]}: its value is missing; write {flag} VALUE")


def _nearest_key(name: str) -> str:
    """The nearest settings: all of them would be a long line."""
    every = list(keys())
    section, _, last = name.rpartition(".")
    same_ending = [key for key in every if key.rpartition(".")[2] == last]
    siblings = [key for key in every if section and key.startswith(section + ".")]
    return nearest(
        name, same_ending or siblings or sorted({key.partition(".")[0] for key in every})
    )


def _flag(arguments: list[str], flag: str) -> str | None:
    """The value of `--flag VALUE` or `--flag=VALUE`."""
    for position, argument in enumerate(arguments):
        if argument == flag and position + 1 < len(arguments):
            return arguments[position + 1]
        if argument.startswith(flag + "="):
            return argument.partition("=")[2]
    return None


def _with_lists(arguments: list[str]) -> list[str]:
    """``--grid.models all`` is short for ``--grid.models '[all]'``."""
    flag, short = "--grid.models", list(arguments)
    for position, argument in enumerate(arguments):
        name, equals, value = argument.partition("=")
        if name == flag and value in GROUPS:
            short[position] = f"{flag}{equals}[{value}]"
        elif argument in GROUPS and position and arguments[position - 1] == flag:
            short[position] = f"[{argument}]"
    return short


def _check_file(path: Path) -> None:
    """The file is there, is YAML, is a mapping, and knows only our settings."""
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        there = sorted(str(p) for p in path.parent.glob("*.yaml"))
        hint = nearest(str(path), there) if there else f"there is no YAML file in {path.parent}"
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
