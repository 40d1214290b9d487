"""Named arrays in one safetensors file, with facts about them in its header.

A file may be larger than memory. It can be written part by part, and reading maps it, so that the
system loads only the pages in use.
"""

import hashlib
import json
import math
import mmap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from study.common.arrays import Array
from study.common.errors import StudyError
from study.common.files import replacing

Arrays = dict[str, Array]
HEADER_KEY = "study"
"""The entry of the safetensors metadata that holds the checksum and the facts."""
TYPES = {
    **{f"{kind}{8 * size}": f"<{kind.lower()}{size}" for kind in "IU" for size in (1, 2, 4, 8)},
    **{f"F{8 * size}": f"<f{size}" for size in (2, 4, 8)},
    "BOOL": "?",
}
"""NumPy's types by their safetensors names."""
READ_SIZE = 2**20
"""Bytes that are read and hashed at a time."""
NO_CHECKSUM = "0" * 64
"""Placeholder in the header until the checksum is known; it has the same length."""


@dataclass(frozen=True)
class Location:
    """The location of an array in a file.

    Attributes:
        dtype: type of the numbers.
        shape: shape of the array.
        start: first byte.
    """

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    start: int

    @property
    def size(self) -> int:
        """Length in bytes."""
        return self.dtype.itemsize * math.prod(self.shape)


def save_arrays(path: Path, arrays: Arrays, facts: dict[str, Any] | None = None) -> None:
    """Write arrays and a checksum to `path`. The same arrays and facts give the same bytes."""
    arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        digest.update(_array_header(name, array.dtype, array.shape))
        digest.update(array.data if array.size else b"")
    with replacing(path) as temporary:
        save_file(arrays, temporary, {HEADER_KEY: _header_entry(digest.hexdigest(), facts)})


def save_parts(
    path: Path, parts: Iterable[Arrays], rows: int, facts: dict[str, Any] | None = None
) -> None:
    """Write float32 arrays that are given part by part.

    The file has the same bytes as if `save_arrays` wrote all parts together. One part is in memory
    at a time.

    Args:
        path: the file.
        parts: in each part the next rows (first axis) of every array.
        rows: number of rows of all parts together.
        facts: JSON values about the arrays.

    Raises:
        ValueError: the parts differ in shape, or their rows do not add up to `rows`.
    """
    with replacing(path) as temporary, temporary.open("wb+") as file:
        locations: dict[str, Location] = {}
        shapes: dict[str, tuple[int, ...]] = {}
        written = 0
        for part in parts:
            if not locations:
                shapes = {name: (rows, *array.shape[1:]) for name, array in part.items()}
                locations = _write_header(file, shapes, _header_entry(NO_CHECKSUM, facts))
            (length,) = {len(array) for array in part.values()}
            end = written + length
            if end > rows or {n: (rows, *a.shape[1:]) for n, a in part.items()} != shapes:
                raise ValueError(f"{path}: rows {written} to {end} do not fit its shapes")
            for name, array in part.items():
                location = locations[name]
                file.seek(location.start + written * (location.size // rows))
                file.write(np.ascontiguousarray(array, location.dtype).data if array.size else b"")
            written = end
        if written != rows:
            raise ValueError(f"{path}: got {written} rows, expected {rows}")
        # The checksum replaces `NO_CHECKSUM`, which has the same length.
        _write_header(file, shapes, _header_entry(_checksum(file, locations), facts))


def load_arrays(path: Path) -> tuple[Arrays, dict[str, Any]]:
    """Read the arrays in `path`, and the facts about them.

    The checksum of the whole file is verified. Then the arrays are mapped copy-on-write: writing
    into them does not change the file.

    Raises:
        StudyError: the file is missing, incomplete or damaged, or another program wrote it.
    """
    try:
        locations, header = _read_header(path)
        with path.open("rb") as file:
            checksum = _checksum(file, locations)
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
    except (OSError, SafetensorError, ValueError, KeyError) as error:
        raise StudyError(f"cannot read {path}: {error}") from error
    if header.get("sha256") != checksum or "facts" not in header:
        raise StudyError(f"{path} is damaged: its checksum differs from the one in its header")
    arrays: Arrays = {
        name: np.ndarray(location.shape, location.dtype, mapped, location.start)
        for name, location in locations.items()
    }
    return arrays, header["facts"]


def load_parts(path: Path, name: str, rows: int) -> Iterator[Array]:
    """Read one array part by part, `rows` rows of its first axis at a time.

    The checksum is not verified.
    """
    location = _read_header(path)[0][name]
    row = np.dtype((location.dtype, location.shape[1:]))
    with path.open("rb") as file:
        file.seek(location.start)
        for start in range(0, location.shape[0], rows):
            yield np.fromfile(file, row, min(rows, location.shape[0] - start))


def _header_entry(checksum: str, facts: dict[str, Any] | None) -> str:
    # A single entry, since safetensors does not keep the order of several.
    return json.dumps({"sha256": checksum, "facts": facts or {}}, sort_keys=True)


def _write_header(
    file: BinaryIO, shapes: Mapping[str, tuple[int, ...]], entry: str
) -> dict[str, Location]:
    """Write the header that safetensors gives float32 arrays of these shapes."""
    dtype = np.dtype(TYPES["F32"])
    entries: dict[str, Any] = {"__metadata__": {HEADER_KEY: entry}}
    start = 0
    for name, shape in sorted(shapes.items()):
        end = start + dtype.itemsize * math.prod(shape)
        entries[name] = {"dtype": "F32", "shape": list(shape), "data_offsets": [start, end]}
        start = end
    text = json.dumps(entries, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 8)
    file.seek(0)
    file.write(len(text).to_bytes(8, "little") + text)
    return _locations(entries, file.tell())


def _read_header(path: Path) -> tuple[dict[str, Location], dict[str, Any]]:
    """The locations of the arrays, and the entry with checksum and facts."""
    # safetensors verifies the header and the file's length.
    with safe_open(path, framework="np") as checked:
        header = json.loads((checked.metadata() or {}).get(HEADER_KEY, "{}"))
    with path.open("rb") as file:
        entries = json.loads(file.read(int.from_bytes(file.read(8), "little")))
        return _locations(entries, file.tell()), header


def _locations(entries: Mapping[str, Any], base: int) -> dict[str, Location]:
    return {
        name: Location(
            np.dtype(TYPES[entry["dtype"]]),
            tuple(entry["shape"]),
            base + entry["data_offsets"][0],
        )
        for name, entry in entries.items()
        if name != "__metadata__"
    }


def _checksum(file: BinaryIO, locations: Mapping[str, Location]) -> str:
    """SHA-256 of the names, types, shapes and numbers in the file."""
    digest = hashlib.sha256()
    for name, location in sorted(locations.items()):
        digest.update(_array_header(name, location.dtype, location.shape))
        file.seek(location.start)
        remaining = location.size
        while remaining:
            block = file.read(min(remaining, READ_SIZE))
            if not block:
                raise ValueError("the file is too short")
            digest.update(block)
            remaining -= len(block)
    return digest.hexdigest()


def _array_header(name: str, dtype: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    return f"{name} {dtype.str} {shape};".encode()
