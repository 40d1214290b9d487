"""A results folder by itself: its ``study.json`` has the settings, no configuration is needed."""

from dataclasses import asdict, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

from study.common.errors import BadInput, StudyError, nearest
from study.common.files import read_json
from study.config.grid import Cell, among, cells
from study.config.settings import Config
from study.config.validation import check

# A results folder of another format is not touched.
FORMAT = 1
STUDY = "study.json"


@dataclass(frozen=True)
class Stored:
    """What ``study.json`` says.

    Attributes:
        out: the results folder.
        config: the settings of the study. Where its stages ran is not kept.
        complete: the cells that have results.
        versions: what they were made with, by package.
    """

    out: Path
    config: Config
    complete: tuple[Cell, ...]
    versions: dict[str, str]

    def cell(self, name: str, flag: str) -> Cell:
        """The complete cell of that name.

        Raises:
            BadInput: there is none; it says so of the command line's `flag`.
        """
        for cell in self.complete:
            if cell.name == name:
                return cell
        names = [cell.name for cell in self.complete]
        raise BadInput(f"{flag}: {self.out} has no cell '{name}': {nearest(name, names)}")

    def weights(self, cell: Cell) -> Path:
        """Where the fitted model of a cell is, if it has one of its own."""
        return self.out / "weights" / f"{cell.name}.safetensors"

    def ships(self, cell: Cell) -> bool:
        """Whether the study was told to publish that file."""
        return not cell.is_reference and among(cell, self.config.publish.weights)


def read(out: Path) -> Stored:
    """Read what a study left behind.

    Raises:
        BadInput: there is no study, or one of another version.
        StudyError: its ``study.json`` is damaged.
    """
    path = out / STUDY
    if not path.is_file():
        raise BadInput(f"there is no study in '{out}': no {STUDY}{_near(out)}")
    try:
        facts = read_json(path)
        form = facts["format"]
        if form != FORMAT:
            raise BadInput(
                f"{out} was made by another version (format {form}, this one reads {FORMAT})"
            )
        config = _build(Config, facts["settings"])
        by_name = {cell.name: cell for cell in cells(config)}
        complete = tuple(by_name[name] for name in facts["cells"])
        versions = {str(name): str(version) for name, version in facts["versions"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise StudyError(
            f"{path} is damaged ({type(error).__name__}: {error}); restore it, "
            f"or make it again: python -m study.run all"
        ) from None
    check(config)
    return Stored(out, config, complete, versions)


def settings_of(config: Config) -> dict[str, Any]:
    """All settings but where the stages ran: no number depends on that."""
    settings = asdict(config)
    settings.pop("engine")
    return settings


def _near(out: Path) -> str:
    """The studies beside the folder that was asked for."""
    there = sorted(str(path.parent) for path in out.parent.glob(f"*/{STUDY}"))
    return f"; {nearest(str(out), there)}" if there else ""


def _build(kind: Any, values: dict[str, Any]) -> Any:
    """The settings in their dataclasses; one that is not given has its default."""
    known = {entry.name: entry.default for entry in fields(kind)}
    unknown = [name for name in values if name not in known]
    if unknown:
        raise BadInput(
            f"the study was made by another version, which had a setting '{unknown[0]}'; "
            "make it again: python -m study.run all"
        )

    def convert(name: str, value: Any) -> Any:
        default = known[name]
        if is_dataclass(default):
            return _build(type(default), value)
        return tuple(value) if isinstance(default, tuple) else value

    return kind(**{name: convert(name, value) for name, value in values.items()})
