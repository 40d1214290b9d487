"""From the command line and a YAML file to a checked `Config`, or to one clear line.

jsonargparse reads and types the settings; what it would say in several lines, or not at all, is
looked at first, so that every error names the setting, what was given and what is allowed.
"""

import re
import warnings
from argparse import ArgumentError, RawDescriptionHelpFormatter
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import yaml
from jsonargparse import ArgumentParser, DefaultHelpFormatter

from study import stored
from study.config import Config, check, keys
from study.errors import BadInput, nearest
from study.grid import GROUPS, with_groups

CONFIGS = Path(__file__).resolve().parent.parent / "configs"

COMMANDS = {
    "all": "run the study: whatever is not up to date, then tables, figures, recordings",
    "plan": "say what `all` would run, and for each stage why",
    "status": "say what is done, running or failed, with times",
    "figures": "draw tables and figures again from the results alone",
    "view": "open recordings in the Rerun viewer: view study, view pusher/low/residual_vae/seed-0",
    "compare": "settings that differ and scores of cells, side by side: compare CELL CELL",
    "portrait": "write a page with pictures of an environment, and of how hard its scenarios are",
    "export": "write training data as a Minari data set, to share: export pusher",
    "forecast": "forecast a test scenario, or a plan from a file, with the weights of a study",
    "verify": "check a study's files, draw its tables and figures again, and compare",
}

# These read everything in the results folder itself: they take no settings.
STORED = ("forecast", "verify")
DEFAULT_OUT = "results/quick"

# What a command takes that the others do not: an argument, then flags.
OWN: dict[str, dict[str, dict[str, Any]]] = {
    "view": {
        "cell": {"help": "such as pusher/low/residual_vae/seed-0; or an environment; or study"},
        "--kind": {"default": "forecast", "help": "forecast, scores, training, tuning"},
        "--save": {"help": "folder for a picture of every view, drawn without a screen"},
    },
    "compare": {"cells": {"nargs": "+", "help": "such as pusher/low/residual_vae/seed-0"}},
    "portrait": {
        "environment": {"nargs": "?", "help": "such as pusher; all of the grid by default"},
        "--to": {"help": "folder of the page; OUT/environments by default"},
    },
    "export": {
        "environment": {"help": "such as pusher"},
        "--to": {"help": "folder of Minari data sets; Minari's own by default"},
    },
    "forecast": {
        "--cell": {"required": True, "help": "whose forecaster: uav/high/residual_vae/seed-0"},
        "--scenario": {
            "type": int,
            "help": "a test scenario, from 0 on; with --file, the one whose noise is used",
        },
        "--file": {"help": "a plan of your own, .csv or .json: start, task and actions"},
        "--samples": {"type": int, "help": "forecasts; as many as the study's if not given"},
        "--save": {"help": "recording to write (FILE.rrd), in place of opening the viewer"},
        "--write": {"help": "write the plan to this .csv or .json file, to edit, and do no more"},
        "--out": {"default": DEFAULT_OUT, "help": "results folder"},
    },
    "verify": {
        "out": {"nargs": "?", "default": DEFAULT_OUT, "help": "results folder; results/quick"},
        "--rerun": {"help": "evaluate this cell again from its weights, and compare its scores"},
    },
}

EPILOG = {
    "forecast": """\
a plan has these columns, named and in the units of study/envs/README.md:
  s0.NAME      the state at the start, one value:  s0.x, s0.y, …
  task.NAME    what is asked for, one value:       task.target_x, …
  action.NAME  a value for each control step:      action.vx, …
In CSV the first row has all of them; the rows after it leave s0 and task empty.
In JSON: {"s0": {"x": 0.0, …}, "task": {…}, "action": {"vx": [1.0, …], …}}.

examples
  python -m study.run forecast --cell uav/high/residual_vae/seed-0 --scenario 17 --samples 200
  python -m study.run forecast --cell uav/high/residual_vae/seed-0 --scenario 17 --write plan.csv
  python -m study.run forecast --cell uav/low/full_vae/seed-0 --file plan.csv --save plan.rrd""",
    "verify": """\
checks   every file against SHA256SUMS; every recording against its own checksum; claims, tables
         and figures against those that the scores give when they are drawn again
--rerun  the test set is drawn again too, unless work/ holds it. The same machine gives the same
         scores; another may round differently: a score over all scenarios may differ by 0.001
         (the tables print three digits), and of those of single scenarios 1 % by more
exit     0 if all is as it was written, 1 if something differs

examples
  python -m study.run verify results/paper
  python -m study.run verify results/paper --rerun uav/high/residual_vae/seed-0""",
}

HELP = """usage: python -m study.run COMMAND [--config FILE] [--out DIR] [--any.setting VALUE]

{commands}

  --config FILE      settings; configs/quick.yaml if not given (also: smoke.yaml, paper.yaml)
  --out DIR          where results go; results/NAME if not given
  --only PATTERN     some cells only: 'pusher/high/*', '*/residual_vae/*'
  --kind KIND        view: which of a cell's recordings, forecast (default), scores, training or
                     tuning; `view pusher` opens the environment's data, `view study` every
                     cell's curves, tables and claims together
  --save DIR         view: no window; pictures of every view go to this folder
  --to DIR           portrait: folder of the page; export: folder of Minari data sets
  (forecast and verify read all settings in the results folder: forecast --help, verify --help)

examples
  python -m study.run all
  python -m study.run plan --config configs/paper.yaml
  python -m study.run all --only 'uav/low/*' --tune.trials 12 --engine.workers 2
  python -m study.run view study
  python -m study.run view pusher/low/residual_vae/seed-0 --kind scores --save pictures
  python -m study.run compare uav/low/residual_vae/seed-0 uav/low/full_vae/seed-0
  python -m study.run forecast --cell uav/high/residual_vae/seed-0 --scenario 17 --samples 200
  python -m study.run verify results/quick --rerun uav/high/residual_vae/seed-0

`python -m study.run all --help` lists every setting.
"""


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


def usage() -> str:
    """The text of ``python -m study.run --help``."""
    width = max(map(len, COMMANDS))
    return HELP.format(commands="\n".join(f"  {c:{width}}  {t}" for c, t in COMMANDS.items()))


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
        return Command(command, stored.read(out).config, out, **own)
    given = _flag(rest, "--config")
    _check_file(Path(given) if given else CONFIGS / "quick.yaml")
    if given is None:
        rest = ["--config", str(CONFIGS / "quick.yaml"), *rest]
    config, namespace = _read(parser, _with_lists(rest))
    config = replace(config, grid=with_groups(config.grid))
    check(config)
    out = Path(namespace.out) if namespace.out else Path("results") / config.name
    own = {_name(name): getattr(namespace, _name(name)) for name in OWN.get(command, ())}
    return Command(command, config, out, namespace.only, **own)


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
