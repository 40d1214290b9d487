"""Which recording a command asks for, and which cells there are to ask for."""

from pathlib import Path

from study.commands.parser import Command
from study.common.errors import BadInput, StudyError, nearest
from study.config.grid import Cell, cells
from study.results import folder

KINDS = ("forecast", "scores", "training", "tuning")
# What `view` takes in place of a cell.
WHOLE = "study"
MISSING = "python -m study.run all makes it (a cell's only if publish.recordings names the cell)"


def recording_of(command: Command) -> Path:
    """The recording that `view` is to open: of a cell, of an environment's data, of the study.

    Raises:
        BadInput: there is no such cell or kind.
        StudyError: it has not been made.
    """
    recordings, name = command.out / "recordings", str(command.cell)
    known = known_cells(command)
    environments = list(dict.fromkeys(cell.environment for cell in known))
    if name in environments:
        path = recordings / name / "data.rrd"
    elif name == WHOLE:
        path = recordings / "study.rrd"
    else:
        check_cell(name, [*(cell.name for cell in known), *environments, WHOLE])
        if command.kind not in KINDS:
            raise BadInput(f"--kind: got '{command.kind}'; {nearest(command.kind, KINDS)}")
        path = recordings / name / f"{command.kind}.rrd"
    if not path.is_file():
        there = sorted(file.stem for file in (recordings / name).glob("*.rrd"))
        kinds = ", ".join(kind for kind in there if kind in KINDS)
        hint = f"there is --kind: {kinds}" if kinds else MISSING
        if kinds and command.kind == "forecast":
            hint += f"; python -m study.run forecast --cell {name} --scenario 0 makes one"
        raise StudyError(f"there is no recording {path}; {hint}")
    return path


def known_cells(command: Command) -> list[Cell]:
    """The cells of the results folder, and those of the configuration, which it may not have."""
    known = cells(command.config)
    if (command.out / folder.STUDY).is_file():
        known = [*cells(folder.read(command.out).config), *known]
    return list(dict.fromkeys(known))


def check_cell(name: str, known: list[str]) -> None:
    """Raise `BadInput` for a cell that is not known, with the nearest one that is."""
    if name not in known:
        raise BadInput(f"unknown cell '{name}': {nearest(name, known)}")
