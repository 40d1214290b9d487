"""Recordings that are whole or not there: written beside their place, moved when complete."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

from study.common.errors import StudyError
from study.common.files import sha256


def checksum_path(path: Path) -> Path:
    """Where the SHA-256 of a recording is kept: `forecast.rrd.sha256`."""
    return path.with_name(f"{path.name}.sha256")


def temporary_path(path: Path) -> Path:
    """A hidden, unique name in the same folder: the move is atomic, and writers never meet."""
    return path.with_name(f".{path.name}.{uuid4().hex[:12]}")


def complete(temporary: Path, path: Path) -> None:
    """Move a finished recording to its place, with its checksum in the form of `sha256sum`.

    Killed between the two moves, it leaves the new recording with the old checksum: `check` then
    calls it damaged and it is made again, which costs time but never trust.
    """
    checksum = temporary.with_name(f"{temporary.name}.sha256")
    checksum.write_text(f"{sha256(temporary)}  {path.name}\n", encoding="utf-8")
    for file in (temporary, checksum):
        with file.open("rb") as opened:
            os.fsync(opened.fileno())
    os.replace(temporary, path)
    os.replace(checksum, checksum_path(path))


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary name to write to; on success it becomes `path`, on failure it vanishes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = temporary_path(path)
    try:
        yield temporary
        complete(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
        temporary.with_name(f"{temporary.name}.sha256").unlink(missing_ok=True)


def check(path: Path) -> None:
    """Check that a recording is whole: a single flipped bit or missing byte is found.

    Raises:
        StudyError: it, or its checksum, is missing, empty or does not match.
    """
    path = Path(path)
    checksum = checksum_path(path)
    if not path.is_file():
        raise StudyError(f"recording {path} is missing")
    if path.stat().st_size == 0:
        raise StudyError(f"recording {path} is empty")
    try:
        expected = checksum.read_text(encoding="utf-8").split()[0]
    except FileNotFoundError:
        raise StudyError(f"recording {path} has no checksum: {checksum.name} is missing") from None
    except (IndexError, UnicodeDecodeError):
        raise StudyError(f"recording {path} has no checksum: {checksum.name} is damaged") from None
    if sha256(path) != expected:
        raise StudyError(f"recording {path} is damaged: its bytes do not match {checksum.name}")
