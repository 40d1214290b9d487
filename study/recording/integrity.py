"""Recordings are complete or absent. The SHA-256 of each is in a file beside the recording."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from study.common.errors import StudyError
from study.common.files import read_checksums, replacing, sha256, write_checksums
from study.common.read_back import read_back, why_incomplete


def checksum_path(path: Path) -> Path:
    """The file with the SHA-256 of a recording: `forecast.rrd.sha256`."""
    return path.with_name(f"{path.name}.sha256")


@contextmanager
def writing(path: Path) -> Iterator[Path]:
    """Write to a temporary path, which then becomes the recording `path` with its checksum.

    If the block raises, the old recording stays. If the process is killed before it writes the
    checksum, `check` reports the recording as damaged, and the study writes the recording again.

    Raises:
        StudyError: what was written cannot be read back.
    """
    with replacing(path) as temporary:
        yield temporary
        read_back(temporary, path)
    write_checksums(checksum_path(path), {path.name: sha256(path)})


def read_checksum(path: Path) -> str:
    """The SHA-256 of a recording, in hexadecimal, as its checksum file states it.

    Raises:
        StudyError: the checksum file is missing or damaged.
    """
    checksum = checksum_path(path)
    try:
        return read_checksums(checksum)[path.name]
    except FileNotFoundError:
        problem = "missing"
    except (ValueError, KeyError):
        problem = "damaged"
    raise StudyError(f"recording {path} has no checksum: {checksum.name} is {problem}")


def check(path: Path) -> None:
    """Compare a recording with its checksum.

    Raises:
        StudyError: the recording or its checksum is missing or empty, the two do not match, or the
            recording was cut off before its checksum was computed.
    """
    path = Path(path)
    if not path.is_file():
        raise StudyError(f"recording {path} is missing")
    if path.stat().st_size == 0:
        raise StudyError(f"recording {path} is empty")
    if sha256(path) != read_checksum(path):
        raise StudyError(
            f"recording {path} is damaged: its bytes do not match {checksum_path(path).name}"
        )
    if (problem := why_incomplete(path)) is not None:
        raise StudyError(f"recording {path} is damaged, though its checksum matches: {problem}")
