"""Read a file back before its checksum seals it.

A library may lose what it could not write, on a full disk or beyond a limit of the file size, and
say nothing: a checksum of the rest would seal a damaged file. So whatever wrote a file, its format
says here whether it is complete.
"""

import json
import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path

from study.common.errors import StudyError

END_OF_PDF = b"%%EOF"
TAIL = 1024
"""Bytes at the end of a PDF in which its mark of the end must be."""


def read_back(path: Path, name: Path | None = None) -> None:
    """Wait until a file is on the disk, and read it.

    Args:
        path: the file.
        name: what it is going to be called, if it has a temporary name now.

    Raises:
        StudyError: the file is not complete.
        OSError: the disk did not take it.
    """
    with path.open("rb") as file:
        os.fsync(file.fileno())
    if (problem := why_incomplete(path, name)) is not None:
        raise StudyError(
            f"{name or path} was not written completely ({problem}); is the disk full?"
        )


def why_incomplete(path: Path, name: Path | None = None) -> str | None:
    """Why a file cannot be read as what its name says; None if it can, or is of no known format.

    Args:
        path: the file.
        name: see `read_back`.
    """
    read = READERS.get((name or path).suffix.lstrip("."))
    try:
        if read is not None:
            read(path)
    except Exception as error:  # each library has errors of its own
        lines = str(error).strip().splitlines()
        return lines[0][:120] if lines else type(error).__name__
    return None


def _read_recording(path: Path) -> None:
    from rerun.chunk import RrdReader

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a recording without an index is complete, too
        if not sum(chunk.num_rows for chunk in RrdReader(path).stream()):
            raise ValueError("it has no rows")


def _read_parquet(path: Path) -> None:
    from pyarrow.parquet import ParquetFile

    with ParquetFile(path) as table:
        for _ in table.iter_batches():
            pass


def _read_safetensors(path: Path) -> None:
    from safetensors import safe_open

    with safe_open(path, framework="np"):  # it compares the header with the length of the file
        pass


def _read_png(path: Path) -> None:
    from PIL import Image

    with Image.open(path) as image:
        image.load()


def _read_pdf(path: Path) -> None:
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - TAIL))
        if END_OF_PDF not in file.read():
            raise ValueError(f"it does not end with {END_OF_PDF.decode()}")


def _read_json(path: Path) -> None:
    json.loads(path.read_text(encoding="utf-8"))


def _read_text(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    if text and not text.endswith("\n"):
        raise ValueError("its last line has no end")


READERS: Mapping[str, Callable[[Path], None]] = {
    "rrd": _read_recording,
    "parquet": _read_parquet,
    "safetensors": _read_safetensors,
    "png": _read_png,
    "pdf": _read_pdf,
    "json": _read_json,
    **dict.fromkeys(("csv", "html", "log", "md", "sha256", "tex"), _read_text),
}
"""How a file is read, by the ending of its name."""
