"""The command line: which commands there are, and from arguments to a command and its options."""

from argparse import RawDescriptionHelpFormatter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jsonargparse import ArgumentParser, DefaultHelpFormatter

from study.commands import (
    ablate,
    compare,
    export,
    figures,
    forecast,
    join,
    plan,
    portrait,
    run_all,
    status,
    verify,
    view,
)
from study.commands.command import Command
from study.commands.settings import (
    add_settings,
    check_flags,
    known_flags,
    parse_arguments,
    parse_settings,
)
from study.common.errors import BadInput, nearest
from study.common.plugins import import_plugins

MODULES = (
    run_all,
    plan,
    status,
    figures,
    view,
    compare,
    portrait,
    export,
    forecast,
    verify,
    join,
    ablate,
)
COMMANDS: Mapping[str, Command[Any]] = {module.COMMAND.name: module.COMMAND for module in MODULES}

USAGE = """\
usage: python -m study.run COMMAND [--config FILE] [--out DIR] [--any.setting VALUE]

{commands}

  --config FILE    settings; configs/quick.yaml if not given (also: smoke, paper, ablations)
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
        BadInput: in one line, what is wrong.
        SystemExit: after printing help.
    """
    if not arguments:
        raise BadInput(f"a command is missing; {nearest('', COMMANDS)}; try --help")
    name, *rest = arguments
    if name in ("-h", "--help"):
        print(usage())
        raise SystemExit(0)
    if name.startswith("-"):
        raise BadInput(
            f"'{name}' stands before the command; write: python -m study.run all {name} …"
        )
    if name not in COMMANDS:
        raise BadInput(f"unknown command '{name}': {nearest(name, COMMANDS)}")
    command = COMMANDS[name]
    if not command.takes_settings:
        return command, _own_options(command, rest)
    return command, _study_options(command, rest)


def usage() -> str:
    """The text of ``python -m study.run --help``."""
    width = max(map(len, COMMANDS))
    lines = [f"  {command.name:{width}}  {command.summary}" for command in COMMANDS.values()]
    return USAGE.format(commands="\n".join(lines))


def _own_options(command: Command[Any], arguments: list[str]) -> Any:
    """The options of a command that takes no settings."""
    for argument in arguments:
        flag = argument.partition("=")[0]
        if flag.startswith("--") and flag not in (*command.flags, "--help"):
            raise BadInput(f"{command.name} has no '{flag}': {nearest(flag, command.flags)}")
    check_flags(arguments, command.flags)
    namespace = parse_arguments(_parser(command), arguments)
    return command.read_options(namespace)


def _study_options(command: Command[Any], arguments: list[str]) -> Any:
    """The options of a command that takes settings."""
    parser = _parser(command)
    parser.add_argument(
        "--config", action="config", help="YAML file of settings; configs/quick.yaml by default"
    )
    parser.add_argument("--out", help="results folder; results/NAME by default")
    parser.add_argument("--only", help="cells whose name matches, such as 'pusher/high/*'")
    # The list of all settings would hide what is special about the other commands.
    if command.name == "all" or not {"-h", "--help"} & set(arguments):
        add_settings(parser)
    check_flags(arguments, ["--config", "--out", "--only", *command.flags, *known_flags()])
    config, namespace = parse_settings(parser, arguments)
    import_plugins(config.plugins)
    out = Path(namespace.out) if namespace.out else Path("results") / config.name
    return command.read_options(namespace, config=config, out=out, only=namespace.only)


def _parser(command: Command[Any]) -> ArgumentParser:
    parser = ArgumentParser(
        prog=f"python -m study.run {command.name}",
        usage=_usage_line(command),
        description=f"{command.summary}\n\n{command.details}",
        formatter_class=_Formatter,
        exit_on_error=False,
    )
    for name, parsing in command.arguments.items():
        parser.add_argument(name, **parsing)
    return parser


def _usage_line(command: Command[Any]) -> str:
    words = [f"python -m study.run {command.name}"]
    for name, parsing in command.arguments.items():
        value = name.strip("-").upper()
        word = f"{name} {value}" if name.startswith("--") else value
        is_optional = "default" in parsing
        words.append(f"[{word}]" if is_optional else word + " …" * ("nargs" in parsing))
    if command.takes_settings:
        words += ["[--config FILE]", "[--out DIR]", "[--only PATTERN]", "[--any.setting VALUE]"]
    return " ".join(words)


class _Formatter(RawDescriptionHelpFormatter, DefaultHelpFormatter):
    """Keeps the line breaks of the details, and shows types and defaults of settings."""
