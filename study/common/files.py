"""Files that are complete or absent: atomic writes, checksums, and JSON with stable bytes."""

import errno
import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from study.common.errors import explain


def sha256(path: Path) -> str:
    """The SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def digest(value: Any) -> str:
    """The SHA-256 of a JSON value."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


@contextmanager
def replacing(path: Path, sync: bool = False) -> Iterator[Path]:
    """Write a file under a temporary name, and rename it when it is complete.

    A reader finds the old file or the new one, never a part. The temporary name is always the same,
    so that the next writer overwrites what a killed process left.

    Args:
        path: the file; its folder is created.
        sync: wait until the bytes are on the disk, so that a power failure leaves no empty file.

    Yields:
        the temporary path to write to. If the block raises, the file is removed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.new")
    try:
        yield temporary
        if sync:
            with temporary.open("rb") as file:
                os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically, in UTF-8."""
    with replacing(path, sync=True) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any, *, sort_keys: bool = True) -> None:
    """Write a JSON file atomically; the same value gives the same bytes.

    Args:
        path: the file.
        value: to write.
        sort_keys: whether keys are in alphabetical order; otherwise they keep their order.
    """
    write_text(path, json.dumps(value, indent=2, sort_keys=sort_keys, ensure_ascii=False) + "\n")


def read_json(path: Path) -> Any:
    """The value in a JSON file."""
    return json.loads(path.read_text(encoding="utf-8"))


def copy(source: Path, target: Path) -> None:
    """Copy a file atomically.

    Raises:
        OSError: the copy has other bytes than the file.
    """
    with replacing(target, sync=True) as temporary:
        shutil.copyfile(source, temporary)
        if not same_bytes(source, temporary):
            raise OSError(errno.EIO, "the copy has other bytes than the file", str(target))


def why_not_writable(folder: Path) -> str | None:
    """Why no file can be written into a folder, which need not exist; None if one can."""
    try:
        while not folder.exists():
            folder = folder.parent
        if not folder.is_dir():
            return f"'{folder}' is not a folder"
        if not os.access(folder, os.W_OK | os.X_OK):
            return f"no permission to write to '{folder}', or its file system is read-only"
    except OSError as error:  # such as a name that is too long
        return explain(error)
    return None


def same_bytes(one: Path, other: Path) -> bool:
    """Whether both files exist and hold the same bytes."""
    if not one.is_file() or not other.is_file() or one.stat().st_size != other.stat().st_size:
        return False
    return sha256(one) == sha256(other)


def write_checksums(path: Path, checksums: Mapping[str, str]) -> None:
    """Write the SHA-256 of files as ``sha256sum --check`` reads it.

    Args:
        path: the file of checksums.
        checksums: SHA-256 by file name, relative to the folder of `path`.
    """
    write_text(path, "".join(f"{value}  {name}\n" for name, value in checksums.items()))


def read_checksums(path: Path) -> dict[str, str]:
    """What `write_checksums` wrote: SHA-256 by file name.

    Raises:
        OSError: the file is missing or cannot be read.
        ValueError: it holds no checksums.
    """
    pairs = [line.split("  ", 1) for line in path.read_text(encoding="utf-8").splitlines()]
    checksums = {name: value for value, name in pairs}
    if not checksums:
        raise ValueError("it is empty")
    return checksums
