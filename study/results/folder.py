"""A results folder: read its ``study.json``, and check that the folder is writable.

``study.json`` has all settings of the study, so a reader needs no configuration file.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from study.common.errors import BadInput, StudyError, explain, nearest
from study.common.files import read_json, why_not_writable, write_json
from study.common.plugins import import_plugins
from study.config.grid import Cell, among, cells
from study.config.recorded import register_recorded
from study.config.settings import Config
from study.config.tree import from_json, to_json
from study.config.values import check_setting
from study.results.origin import Origin
from study.results.origin import from_json as origin_from_json

FORMAT = 1
"""Version of the layout of a results folder. Other versions are neither read nor overwritten."""
STUDY = "study.json"
RUN_SETTINGS = Path("work") / "settings.json"
STUDY_RECORDING = Path("recordings") / "study.rrd"
RUN_AGAIN = "python -m study.run all writes it again"


@dataclass(frozen=True)
class Results:
    """The results folder of a study.

    Attributes:
        out: the folder.
        config: settings of the study; the settings of the engine are the defaults.
        complete: the cells that have results.
        origin: versions, device and source of the results.
    """

    out: Path
    config: Config
    complete: tuple[Cell, ...]
    origin: Origin

    def cell(self, name: str, flag: str) -> Cell:
        """The complete cell called `name`.

        Raises:
            BadInput: there is no such cell. The error names `flag`, the flag of the command line.
        """
        for cell in self.complete:
            if cell.name == name:
                return cell
        names = [cell.name for cell in self.complete]
        raise BadInput(f"{flag}: {self.out} has no cell '{name}': {nearest(name, names)}")

    def weights(self, cell: Cell) -> Path:
        """Path of the weights of a cell's model."""
        return self.out / "weights" / f"{cell.name}.safetensors"

    def has_weights(self, cell: Cell) -> bool:
        """Whether the setting ``publish.weights`` includes the weights of the cell."""
        return not cell.is_reference and among(cell, self.config.publish.weights)


def read(out: Path) -> Results:
    """Read the ``study.json`` of a results folder, and import the plugins of its study.

    Raises:
        BadInput: there is no study, the study is of another version, or a plugin is missing.
        StudyError: ``study.json`` is damaged.
    """
    path = out / STUDY
    if not path.is_file():
        raise BadInput(f"there is no study in '{out}': no {STUDY}{_nearest_study(out)}")
    try:
        facts = read_json(path)
        _check_format(out, facts["format"])
        config = _settings(out, facts["settings"])
        by_name = {cell.name: cell for cell in cells(config)}
        complete = tuple(by_name[name] for name in facts["cells"])
        origin = origin_from_json(facts)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise StudyError(f"{path} is damaged ({reason}); {RUN_AGAIN}") from None
    return Results(out, config, complete, origin)


def settings_of(config: Config) -> dict[str, Any]:
    """All settings as JSON, except those of the engine, which do not change the results."""
    settings = to_json(config)
    settings.pop("engine")
    return settings


def write_run_settings(out: Path, config: Config) -> None:
    """Write the settings at the start of a run, since a run writes ``study.json`` at its end."""
    write_json(out / RUN_SETTINGS, settings_of(config))


def stored_settings(out: Path) -> tuple[Path, dict[str, Any]] | None:
    """The settings of the last run in a results folder, as JSON, and the file that has them.

    Returns:
        None if the folder has no study.

    Raises:
        BadInput: the file is damaged, or the study is of another version.
    """
    check_format(out)
    for name in (RUN_SETTINGS, STUDY):
        path = out / name
        if path.is_file():
            try:
                content = read_json(path)
                return path, dict(content if name == RUN_SETTINGS else content["settings"])
            except (ValueError, KeyError, TypeError):
                raise BadInput(f"{path} is damaged; give the settings with --config") from None
    return None


def check_writable(out: Path) -> None:
    """Check that a results folder can be created or written to.

    Raises:
        BadInput: the folder is not writable, or has a study of another version.
    """
    if problem := why_not_writable(out):
        raise _not_writable(out, problem)
    check_format(out)


def check_format(out: Path) -> None:
    """Check that no study of another version is in a results folder.

    Raises:
        BadInput: there is such a study.
    """
    if (out / STUDY).exists():
        try:
            version = read_json(out / STUDY).get("format")
        except (OSError, ValueError, AttributeError):
            return  # a damaged file, which the run writes again
        _check_format(out, version)


def create(out: Path) -> None:
    """Create a results folder, unless it exists.

    Raises:
        BadInput: the folder cannot be created.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:  # a file system may refuse what permissions allow
        raise _not_writable(out, explain(error)) from error


def _check_format(out: Path, version: Any) -> None:
    if version != FORMAT:
        raise BadInput(
            f"{out} was made by another version of the study (its format is {version}, "
            f"this version has {FORMAT}); give another folder"
        )


def _settings(out: Path, values: Any) -> Config:
    """The settings of a study, after importing its plugins, whose models may have settings."""
    try:
        import_plugins(check_setting("plugins", tuple[str, ...], values.get("plugins", ()), (), {}))
    except BadInput as error:
        raise BadInput(f"{out}: {error}") from None
    register_recorded(values)
    try:
        return from_json(values, unknown=("engine",))
    except BadInput as error:
        raise BadInput(
            f"{out} was made by another version of the study: {error}; run the study again: "
            "python -m study.run all"
        ) from None


def _not_writable(out: Path, problem: str) -> BadInput:
    return BadInput(f"--out: cannot write to '{out}': {problem}; give another folder")


def _nearest_study(out: Path) -> str:
    """The clause of an error that names the studies beside a folder."""
    studies = sorted(str(path.parent) for path in out.parent.glob(f"*/{STUDY}"))
    return f"; {nearest(str(out), studies)}" if studies else ""
