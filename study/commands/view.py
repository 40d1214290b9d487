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
"""What `view` takes in place of a cell for the recording of the whole study."""

DETAILS = """\
what  a cell, for one of its recordings (see --kind); an environment, for its training data; or
      `study`, for the curves, tables and claims of all cells

Without a display, --save DIR writes a picture of every view, and a page of them, to DIR. This needs
a Vulkan driver (on Debian or Ubuntu the package mesa-vulkan-drivers).

examples
  python -m study.run view study
  python -m study.run view pusher
  python -m study.run view pusher/low/residual_vae/seed-0
  python -m study.run view pusher/low/residual_vae/seed-0 --kind scores --save pictures"""


@dataclass(frozen=True, kw_only=True)
class Options(StudyOptions):
    """Options of `view`.

    Attributes:
        cell: name of a cell or of an environment, or `WHOLE_STUDY`.
        kind: which recording of the cell.
        save: folder for pictures; None opens the viewer.
    """

    cell: Annotated[str, Argument("a cell, such as pusher/low/residual_vae/seed-0; pusher; study")]
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
    shown = screenshots(path, options.save)
    print(*shown.pages, *shown.views.values(), sep="\n")
    for problem in shown.problems:
        print(f"error: {problem}", file=sys.stderr)
    return 1 if shown.problems else 0


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
    """The cells of the results folder and of the settings, which may differ from the folder's."""
    known = cells(options.config)
    if (options.out / folder.STUDY).is_file():
        known = [*cells(folder.read(options.out).config), *known]
    return list(dict.fromkeys(known))


def check_cell(name: str, known: list[str]) -> None:
    """Check the name of a cell.

    Raises:
        BadInput: it is unknown. The error names the nearest one.
    """
    if name not in known:
        raise BadInput(f"unknown cell '{name}': {nearest(name, known)}")


def _hint(of_cell: Path, options: Options) -> str:
    """What to do where a recording is missing."""
    kinds = [path.stem for path in sorted(of_cell.glob("*.rrd")) if path.stem in KINDS]
    if not kinds:
        return (
            "python -m study.run all writes it (that of a cell only if the setting "
            "publish.recordings names the cell)"
        )
    hint = f"give --kind: {', '.join(kinds)}"
    if options.kind == "forecast":
        command = f"python -m study.run forecast --cell {options.cell} --scenario 0"
        hint += f"; or run {command} to make one"
    return hint


COMMAND = Command(
    "view",
    "open recordings in the Rerun viewer: view study, view pusher/low/residual_vae/seed-0",
    Options,
    run,
    DETAILS,
)
