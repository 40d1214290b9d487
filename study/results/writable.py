"""The results folder: whether it can be written, and the making of it."""

import os
from pathlib import Path

from study.common.errors import BadInput
from study.common.files import read_json
from study.results import folder


def check_writable(out: Path) -> None:
    """The folder can be written, and is of this version.

    Raises:
        BadInput: it cannot, or is not.
    """
    parent = out
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
        raise _cannot_write(out)
    if (out / folder.STUDY).exists():
        try:
            found = read_json(out / folder.STUDY).get("format")
        except (OSError, ValueError, AttributeError):
            return  # damaged: it is written again
        if found != folder.FORMAT:
            raise BadInput(
                f"--out: {out} was made by another version (format {found}, this one writes "
                f"{folder.FORMAT}); give another --out"
            )


def make(out: Path) -> None:
    """Make the results folder."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:  # a file system may refuse what permissions allow
        raise _cannot_write(out) from error


def _cannot_write(out: Path) -> BadInput:
    return BadInput(f"--out: cannot write to '{out}'; give a folder that you may write to")
