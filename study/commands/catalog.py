"""Command `catalog`: all recordings of a study as a Rerun catalog on this machine."""

import sys
from threading import Event

from study.commands.command import Command, ServerOptions
from study.commands.terminal import console, say

DETAILS = """\
Serves the recordings of a results folder as a Rerun catalog. A dataset has the recordings of one
kind and environment, such as forecast_uav. In the viewer its table has a row for each recording,
with cell, seed, β and scores. A row opens the recording. Python queries the recordings as data
frames: see study/recording/README.md.
Only this machine can connect. The files of the results folder do not change. Ctrl-C ends it.
Needs datafusion: pip install -e '.[catalog]'.

examples
  python -m study.run catalog --out results/paper"""


def run(options: ServerOptions) -> int:
    """Serve until the user interrupts.

    Raises:
        BadInput: the folder has no recordings, or the port is in use.
        StudyError: the extra `catalog` is not installed, or all recordings are damaged.
    """
    from study.page.evidence import check_folder
    from study.recording.catalog import catalog
    from study.recording.viewer import LOCALHOST
    from study.results.cell_scores import cell_scores

    check_folder(options.out)
    try:
        with catalog(options.out / "recordings", cell_scores(options.out), options.port) as started:
            for problem in started.problems:
                print(f"error: {problem}", file=sys.stderr)
            count = sum(started.datasets.values())
            terminal = console()
            say(terminal, f"{count} recordings in {', '.join(started.datasets)}")
            say(terminal, f"{options.out}: {started.address} (Ctrl-C ends it)")
            say(terminal, f"open it: rerun --bind {LOCALHOST} {started.address}/catalog")
            Event().wait()
    except KeyboardInterrupt:
        return 0
    return 0


COMMAND = Command(
    "catalog",
    "all recordings as a Rerun catalog on this machine: filter and query them",
    ServerOptions,
    run,
    DETAILS,
)
