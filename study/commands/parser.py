"""The parser of the command line: from arguments to a command and its options."""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

from study.commands import (
    ablate,
    catalog,
    compare,
    export,
    figures,
    forecast,
    inspect,
    join,
    multiverse,
    page,
    plan,
    portrait,
    run_all,
    serve,
    status,
    verify,
    view,
)
from study.commands.command import Command, read_path
from study.commands.settings import HELP, import_plugins_of, read_config, read_part, split
from study.commands.settings_help import add_settings
from study.common.errors import BadInput, nearest

MODULES = (
    run_all,
    plan,
    status,
    figures,
    page,
    serve,
    catalog,
    view,
    compare,
    portrait,
    export,
    forecast,
    inspect,
    verify,
    join,
    ablate,
    multiverse,
)
COMMANDS: Mapping[str, Command[Any]] = {module.COMMAND.name: module.COMMAND for module in MODULES}

STUDY_FLAGS = {
    "--config": "YAML file of settings; by default those of the study in OUT, if --out is given "
    "and has one, or else configs/quick.yaml",
    "--out": "results folder; results/NAME by default",
    "--only": "cells whose name matches, such as 'pusher/high/*'",
}
"""The flags of every command that takes settings, with their help."""

USAGE = """\
usage: python -m study.run COMMAND [--config FILE] [--out DIR] [--any.setting VALUE]

{commands}

  --config FILE    settings, such as configs/paper.yaml; if not given, those of the study in DIR,
                   or else configs/quick.yaml
  --out DIR        results folder; results/NAME if not given
  --only PATTERN   some cells only: 'pusher/high/*', '*/residual_vae/*'

examples
  python -m study.run all
  python -m study.run plan --config configs/paper.yaml
  python -m study.run all --only 'uav/low/*' --tune.trials 12 --engine.workers 2
  python -m study.run view study
  python -m study.run verify results/paper

`python -m study.run COMMAND --help` explains a command; `all --help` lists every setting as well.
"""


def parse(arguments: list[str]) -> tuple[Command[Any], Any]:
    """Parse a command line.

    Args:
        arguments: the command line without the name of the program.

    Returns:
        the command and its options.

    Raises:
        BadInput: the command or an argument is wrong.
        SystemExit: help was asked for and printed.
    """
    if not arguments:
        raise BadInput(f"a command is missing; {nearest('', COMMANDS)}; try --help")
    name, *others = arguments
    if name in ("-h", "--help"):
        print(usage())
        raise SystemExit(0)
    if name.startswith("-"):
        raise BadInput(f"'{name}' is before the command; write: python -m study.run all {name} …")
    if name not in COMMANDS:
        raise BadInput(f"unknown command '{name}': {nearest(name, COMMANDS)}")
    command = COMMANDS[name]
    if not command.takes_settings:
        return command, _own_options(command, others)
    return command, _study_options(command, others)


def usage() -> str:
    """The text of ``python -m study.run --help``."""
    width = max(map(len, COMMANDS))
    lines = [f"  {command.name:{width}}  {command.summary}" for command in COMMANDS.values()]
    return USAGE.format(commands="\n".join(lines))


def _own_options(command: Command[Any], arguments: list[str]) -> Any:
    """The options of a command that takes no settings."""
    texts, rest = split(arguments, command.flags, command.switches)
    for name in texts:
        raise BadInput(f"{command.name} has no '--{name}': {nearest('--' + name, command.flags)}")
    return command.read_options(_parser(command).parse_args(rest))


def _study_options(command: Command[Any], arguments: list[str]) -> Any:
    """The options of a command that takes settings."""
    texts, rest = split(arguments, [*STUDY_FLAGS, *command.flags], command.switches)
    parser = _parser(command)
    default = f"configs/{Path(command.config).name} by default" if command.config else None
    for flag, text in STUDY_FLAGS.items():
        is_config = flag == "--config" and default is not None
        parser.add_argument(flag, help=f"YAML file of settings; {default}" if is_config else text)
    # For other commands the long list of settings would hide the rest of the help.
    if command.name == "all" and set(HELP) & set(rest):
        import_plugins_of({}, texts)
        add_settings(parser)
    if sum(argument.startswith("--config=") for argument in rest) > 1:
        raise BadInput("--config: given twice; give one file, and flags for what is different")
    values = parser.parse_args(rest)
    out = read_path("--out", values.out) if values.out else None
    file = values.config or command.config
    config = read_config(file, texts, out, command.part)
    parts = {command.part: read_part(file, command.part)} if command.part else {}
    out = out or Path("results") / config.name
    return command.read_options(values, config=config, out=out, only=values.only, **parts)


class _Parser(ArgumentParser):
    """Raises an error as `BadInput`. `ArgumentParser` would print its usage and exit."""

    def error(self, message: str) -> NoReturn:
        raise BadInput(message.removeprefix("argument "))


def _parser(command: Command[Any]) -> ArgumentParser:
    parser = _Parser(
        prog=f"python -m study.run {command.name}",
        usage=_usage_line(command),
        description=f"{command.summary}\n\n{command.details}",
        formatter_class=RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    for name, parsing in command.arguments.items():
        parser.add_argument(name, **parsing)
    return parser


def _usage_line(command: Command[Any]) -> str:
    words = [f"python -m study.run {command.name}"]
    for name, parsing in command.arguments.items():
        value = name.strip("-").upper()
        word = f"{name} {value}" if name.startswith("--") else value
        word = name if name in command.switches else word
        is_optional = "default" in parsing or name in command.switches
        words.append(f"[{word}]" if is_optional else word + " …" * ("nargs" in parsing))
    if command.takes_settings:
        words += ["[--config FILE]", "[--out DIR]", "[--only PATTERN]", "[--any.setting VALUE]"]
    return " ".join(words)
