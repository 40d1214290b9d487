"""Recordings are complete or absent: written under a temporary name, moved with their checksum."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

from study.common.errors import StudyError
from study.common.files import sha256

_HINT = "restore it, or make it again: python -m study.run all"


def checksum_path(path: Path) -> Path:
    """The file with the SHA-256 of a recording: `forecast.rrd.sha256`."""
    return path.with_name(f"{path.name}.sha256")


def temporary_path(path: Path) -> Path:
    """A hidden, unique name in the same folder, so that two writers never share a file."""
    return path.with_name(f".{path.name}.{uuid4().hex[:12]}")


def complete(temporary: Path, path: Path) -> None:
    """Move a finished recording to `path`, with its checksum in the form of `sha256sum`.

    A process that is killed between the two moves leaves the new recording with the old checksum.
    `check` then reports damage, and the study makes the recording again.
    """
    checksum = checksum_path(temporary)
    checksum.write_text(f"{sha256(temporary)}  {path.name}\n", encoding="utf-8")
    for file in (temporary, checksum):
        with file.open("rb") as opened:
            os.fsync(opened.fileno())
    os.replace(temporary, path)
    os.replace(checksum, checksum_path(path))


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path to write to: it becomes `path` on success, and is removed on failure."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = temporary_path(path)
    try:
        yield temporary
        complete(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
        checksum_path(temporary).unlink(missing_ok=True)


def read_checksum(path: Path) -> str:
    """The SHA-256 of a recording, in hexadecimal, as its checksum file states it.

    Raises:
        StudyError: the checksum file is missing or damaged.
    """
    checksum = checksum_path(path)
    try:
        return checksum.read_text(encoding="utf-8").split()[0]
    except FileNotFoundError:
        problem = "missing"
    except (IndexError, UnicodeDecodeError):
        problem = "damaged"
    raise StudyError(f"recording {path} has no checksum: {checksum.name} is {problem}; {_HINT}")


def check(path: Path) -> None:
    """Compare a recording with its checksum.

    Raises:
        StudyError: the recording or its checksum is missing or empty, or the two do not match.
    """
    path = Path(path)
    if not path.is_file():
        raise StudyError(f"recording {path} is missing; {_HINT}")
    if path.stat().st_size == 0:
        raise StudyError(f"recording {path} is empty; {_HINT}")
    expected = read_checksum(path)
    if sha256(path) != expected:
        raise StudyError(
            f"recording {path} is damaged: its bytes do not match {checksum_path(path).name}; "
            f"{_HINT}"
        )
