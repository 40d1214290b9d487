"""A command: its name, summary and options, and the function that runs the command."""

from argparse import ArgumentTypeError
from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar, get_args, get_origin, get_type_hints

from study.common.errors import BadInput, explain, shown
from study.config.settings import Config
from study.config.strict_yaml import INTEGER

DEFAULT_OUT = Path("results/quick")
"""The results folder of commands that take no settings."""
LONGEST_NUMBER = 18
"""Largest number of digits of an integer in an argument."""


@dataclass(frozen=True)
class Argument:
    """Annotates a field of options that is a positional argument of the command line."""

    help: str


@dataclass(frozen=True)
class Flag:
    """Annotates a field of options that is a flag of the command line, `--name VALUE`.

    A flag of the type bool has no value.
    """

    help: str


@dataclass(frozen=True, kw_only=True)
class ServerOptions:
    """Options of a command that serves a results folder on this machine.

    Attributes:
        out: the results folder.
        port: to listen on; 0 for a free one.
    """

    out: Annotated[Path, Flag(f"results folder; {DEFAULT_OUT} by default")] = DEFAULT_OUT
    port: Annotated[int, Flag("port to listen on; by default a free one")] = 0


@dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """The options of all commands that take the settings of a study.

    Attributes:
        config: the settings.
        out: the results folder.
        only: a pattern of cells' names; None for all cells.
    """

    config: Config
    out: Path
    only: str | None = None


Options = TypeVar("Options")


@dataclass(frozen=True)
class Command(Generic[Options]):
    """A command of the command line.

    Attributes:
        name: the word after ``python -m study.run``.
        summary: one line for the list of commands.
        options: the dataclass of options, with fields annotated by `Argument` and `Flag`. A
            subclass of `StudyOptions` gets the settings as well.
        run: runs the command and returns the exit code.
        details: explanation and examples in the help.
        config: YAML file of settings that is used without ``--config``; None for those of the study
            in OUT or ``configs/quick.yaml``.
        part: a part of that file that is no setting. The field of the options with this name gets
            it, as YAML gives it.
    """

    name: str
    summary: str
    options: type[Options]
    run: Callable[[Options], int]
    details: str
    config: str | None = None
    part: str | None = None

    @property
    def takes_settings(self) -> bool:
        """Whether the command line may have settings, such as ``--tune.trials 12``."""
        return issubclass(self.options, StudyOptions)

    @property
    def arguments(self) -> dict[str, dict[str, Any]]:
        """The command's own arguments, by name or flag, for `ArgumentParser.add_argument`."""
        hints = get_type_hints(self.options, include_extras=True)
        return {
            entry.name if isinstance(kind, Argument) else f"--{entry.name}": _parsing(entry, kind)
            for entry in fields(self.options)  # type: ignore[arg-type]
            for kind in getattr(hints[entry.name], "__metadata__", ())
        }

    @property
    def flags(self) -> list[str]:
        """The command's own flags."""
        return [name for name in self.arguments if name.startswith("--")]

    @property
    def switches(self) -> list[str]:
        """The flags that have no value."""
        return [name for name, parsing in self.arguments.items() if "action" in parsing]

    def read_options(self, values: Any, **settings: Any) -> Options:
        """The options from the values of `arguments` on the command line.

        Args:
            values: an attribute for each argument.
            settings: the fields of `StudyOptions`, for a command that takes settings.
        """
        types = get_type_hints(self.options)
        options = {}
        for argument in self.arguments:
            name = argument.strip("-")
            value = getattr(values, name)
            is_path = value is not None and types[name] in (Path, Path | None)
            options[name] = read_path(argument, value) if is_path else value
        return self.options(**options, **settings)


def read_path(argument: str, text: str | Path) -> Path:
    """The path that an argument gives; it need not exist.

    Raises:
        BadInput: no file can have it, or it may not be looked at.
    """
    path = Path(text)
    try:
        path.exists()
    except (OSError, ValueError) as error:
        problem = explain(error) if isinstance(error, OSError) else str(error)
        raise BadInput(f"{argument}: {problem}") from None
    return path


def _whole_number(text: str) -> int:
    if len(text) > LONGEST_NUMBER or not INTEGER.fullmatch(text):
        raise ArgumentTypeError(f"got {shown(text)}; it must be a whole number")
    return int(text)


def _parsing(entry: Field[Any], kind: Argument | Flag) -> dict[str, Any]:
    """The arguments of `ArgumentParser.add_argument` for a field of options."""
    parsing: dict[str, Any] = {"help": kind.help}
    if get_args(entry.type)[0] is bool:
        return parsing | {"action": "store_true"}
    is_required = entry.default is MISSING
    if not is_required:
        parsing["default"] = entry.default
    if get_origin(get_args(entry.type)[0]) is list:
        parsing["nargs"] = "+"
    elif isinstance(kind, Argument) and not is_required:
        parsing["nargs"] = "?"
    elif isinstance(kind, Flag) and is_required:
        parsing["required"] = True
    value_type = get_args(entry.type)[0]
    if int in (value_type, *get_args(value_type)):
        parsing["type"] = _whole_number
    return parsing
