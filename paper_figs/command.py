"""The command line of all scripts of this folder."""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from study.common.errors import StudyError


def command(
    plot: Callable[[Path], list[Path]],
    about: str,
    arguments: Sequence[str] | None = None,
    missing: str = "nothing to write",
) -> int:
    """Run a script on a folder of results, and print the paths of the files it writes.

    Args:
        plot: writes the files of the script.
        about: description of the files, for the help.
        arguments: of the command line; None for those of the process.
        missing: what is printed if the results have no data for the script.

    Returns:
        the exit code. After an error, which is one line on standard error, it is that of the error.
    """
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("results", type=Path, help="results folder of a study: results/paper")
    try:
        paths = plot(parser.parse_args(arguments).results)
        print(*(map(str, paths) if paths else [missing]), sep="\n")
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0
