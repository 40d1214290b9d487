"""What a command is: a name, a summary, its options, and a function that runs it."""

import importlib
import os
import sys
import traceback
from collections.abc import Callable, Iterable
from dataclasses import MISSING, Field, dataclass, fields
from pathlib import Path
from typing import Any, Generic, TypeVar, get_args, get_origin, get_type_hints

from study.common.errors import BadInput
from study.config.settings import Config
from study.results import folder
from study.results.folder import Results

DEFAULT_OUT = Path("results/quick")
"""The results folder of commands that take no settings."""


@dataclass(frozen=True)
class Argument:
    """Annotates a field of options that is a positional argument of the command line."""

    help: str


@dataclass(frozen=True)
class Flag:
    """Annotates a field of options that is a flag of the command line, `--name VALUE`."""

    help: str


@dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """What commands that take the settings of a study have in common.

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
        options: its dataclass of options, with fields annotated by `Argument` and `Flag`. A
            subclass of `StudyOptions` is given the settings as well.
        run: runs it and returns the exit code.
        details: what its help says after the list of options: explanation and examples.
    """

    name: str
    summary: str
    options: type[Options]
    run: Callable[[Options], int]
    details: str

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

    def read_options(self, values: Any, **settings: Any) -> Options:
        """The options from the values that a parser found for `arguments`.

        Args:
            values: an attribute for each argument.
            settings: the fields of `StudyOptions`, for a command that takes settings.
        """
        types = get_type_hints(self.options)
        found = {}
        for argument in self.arguments:
            name = argument.strip("-")
            value = getattr(values, name)
            is_path = value is not None and types[name] in (Path, Path | None)
            found[name] = Path(value) if is_path else value
        return self.options(**found, **settings)


def read_results(out: Path) -> Results:
    """Read a results folder, and import the plugins of its study.

    Raises:
        BadInput: there is no study in it, or one of another version.
        StudyError: it is damaged.
    """
    results = folder.read(out)
    import_plugins(results.config.plugins)
    return results


def import_plugins(names: Iterable[str]) -> None:
    """Import the user's modules, which register environments and models.

    Raises:
        BadInput: a module cannot be imported, or what it registers cannot be used.
    """
    folder = os.getcwd()
    if folder not in sys.path:
        sys.path.insert(0, folder)
    for name in names:
        if name.endswith(".py") or not all(part.isidentifier() for part in name.split(".")):
            raise BadInput(f"plugins: '{name}' is no module; write my_system, or package.module")
        try:
            importlib.import_module(name)
        except BadInput as error:
            raise BadInput(f"plugins: {error}") from None
        except (Exception, SystemExit) as error:
            raise BadInput(f"plugins: cannot import '{name}': {_reason(error)}") from None


def _reason(error: BaseException) -> str:
    """What went wrong in a module, and the file and line of the user where it did, in one line."""
    text = " ".join(str(error).split())[:200]
    if isinstance(error, SyntaxError):
        return f"{error.msg} ({error.filename}, line {error.lineno})" if error.filename else text
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame for frame in frames if not frame.filename.startswith(("<", __file__))]
    lines = [frame for frame in lines if Path(frame.filename).parent.name != "importlib"]
    kind = "" if isinstance(error, ImportError) else f"{type(error).__name__}: "
    where = f" ({lines[-1].filename}, line {lines[-1].lineno})" if lines else ""
    return f"{kind}{text}{where}"


def _parsing(entry: Field[Any], kind: Argument | Flag) -> dict[str, Any]:
    """How `ArgumentParser` reads a field of options."""
    parsing: dict[str, Any] = {"help": kind.help}
    is_required = entry.default is MISSING
    if not is_required:
        parsing["default"] = entry.default
    if get_origin(get_args(entry.type)[0]) is list:
        parsing["nargs"] = "+"
    elif isinstance(kind, Argument) and not is_required:
        parsing["nargs"] = "?"
    elif isinstance(kind, Flag) and is_required:
        parsing["required"] = True
    if int in get_args(get_args(entry.type)[0]):
        parsing["type"] = int
    return parsing
