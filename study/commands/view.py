"""Command `view`: open a recording in the Rerun viewer, or write pictures of it."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from study.commands.command import Argument, Command, Flag, StudyOptions
from study.common.errors import BadInput, StudyError, nearest
from study.common.files import why_not_writable
from study.config.grid import Cell, cells
from study.results import folder

KINDS = ("forecast", "scores", "training", "tuning")
WHOLE_STUDY = "study"
"""The name of the recording of the whole study, in place of a cell."""
MULTIVERSE = "multiverse"
"""The name of the recording of a multiverse, in place of a cell."""

DETAILS = """\
what  a cell, for one of its recordings (see --kind); an environment, for its training data;
      `study`, for the curves, tables and claims of all cells; or `multiverse`, for the effects in
      every universe

Without a display, --save DIR writes a picture of every view, and a page of them, to DIR. This needs
a Vulkan driver (on Debian or Ubuntu the package mesa-vulkan-drivers).

examples
  python -m study.run view study
  python -m study.run view multiverse --out results/multiverse
  python -m study.run view pusher
  python -m study.run view pusher/low/residual_vae/seed-0
  python -m study.run view pusher/low/residual_vae/seed-0 --kind scores --save pictures"""


@dataclass(frozen=True, kw_only=True)
class Options(StudyOptions):
    """Options of `view`.

    Attributes:
        cell: name of a cell or of an environment, or `WHOLE_STUDY`.
        kind: kind of the cell's recording.
        save: folder for pictures; None opens the viewer.
    """

    cell: Annotated[str, Argument("a cell, an environment, study or multiverse")]
    kind: Annotated[str, Flag("forecast, scores, training, tuning")] = "forecast"
    save: Annotated[Path | None, Flag("folder for a picture of every view; needs no screen")] = None


def run(options: Options) -> int:
    """Open the recording, or write pictures of all its views."""
    from study.recording.screenshots import screenshots
    from study.recording.viewer import open_viewer

    path = find_recording(options)
    if options.save is None:
        open_viewer([path])
        return 0
    if problem := why_not_writable(options.save):
        raise BadInput(f"--save: {problem}")
    pictures = screenshots(path, options.save)
    print(*pictures.pages, *pictures.views.values(), sep="\n")
    for problem in pictures.problems:
        print(f"error: {problem}", file=sys.stderr)
    return 1 if pictures.problems else 0


def find_recording(options: Options) -> Path:
    """The recording to open.

    Raises:
        BadInput: there is no such cell or kind.
        StudyError: the recording does not exist.
    """
    recordings, name = options.out / "recordings", options.cell
    known = known_cells(options)
    environments = list(dict.fromkeys(cell.environment for cell in known))
    if name == WHOLE_STUDY:
        path = options.out / folder.STUDY_RECORDING
    elif name == MULTIVERSE:
        path = recordings / "multiverse.rrd"
        if not path.is_file():
            raise StudyError(
                f"there is no recording {path}; python -m study.run multiverse writes it; --out "
                "names the folder"
            )
    elif name in environments:
        path = recordings / name / "data.rrd"
    else:
        check_cell(name, [*(cell.name for cell in known), *environments, WHOLE_STUDY])
        if options.kind not in KINDS:
            raise BadInput(f"--kind: got '{options.kind}'; {nearest(options.kind, KINDS)}")
        path = recordings / name / f"{options.kind}.rrd"
    if not path.is_file():
        raise StudyError(f"there is no recording {path}; {_hint(recordings / name, options)}")
    return path


def known_cells(options: StudyOptions) -> list[Cell]:
    """The cells of the results folder, then those of the settings, without repetition."""
    of_settings = cells(options.config)
    if not (options.out / folder.STUDY).is_file():
        return of_settings
    of_folder = cells(folder.read(options.out).config)
    return list(dict.fromkeys([*of_folder, *of_settings]))


def check_cell(name: str, allowed: list[str]) -> None:
    """Check the name of a cell.

    Raises:
        BadInput: the name is unknown. The error has the nearest name.
    """
    if name not in allowed:
        raise BadInput(f"unknown cell '{name}': {nearest(name, allowed)}")


def _hint(recordings: Path, options: Options) -> str:
    """The clause of an error that says what to do about a missing recording.

    Args:
        recordings: folder of the cell's recordings.
        options: of the command.
    """
    kinds = [path.stem for path in sorted(recordings.glob("*.rrd")) if path.stem in KINDS]
    if not kinds:
        return (
            "python -m study.run all writes it (that of a cell only if the setting "
            "publish.recordings names the cell)"
        )
    hint = f"give --kind: {', '.join(kinds)}"
    if options.kind == "forecast":
        command = f"python -m study.run forecast --cell {options.cell} --scenario 0"
        hint += f"; or run {command} to write one"
    return hint


COMMAND = Command(
    "view",
    "open recordings in the Rerun viewer: view study, view pusher/low/residual_vae/seed-0",
    Options,
    run,
    DETAILS,
)
