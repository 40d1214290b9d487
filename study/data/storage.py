"""Named arrays in one file: safetensors, with the facts about them in its header.

A file may be larger than memory: it can be written part by part, and what is loaded stays in the
file until it is looked at.
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

Arrays = dict[str, Array]
HEADER = "study"
TYPES = {
    **{f"{kind}{8 * size}": f"<{kind.lower()}{size}" for kind in "IU" for size in (1, 2, 4, 8)},
    **{f"F{8 * size}": f"<f{size}" for size in (2, 4, 8)},
    "BOOL": "?",
}
PIECE = 2**20
NO_CHECKSUM = "0" * 64


@dataclass(frozen=True)
class Place:
    """Where in a file an array is: from byte `start` on."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    start: int

    @property
    def size(self) -> int:
        """Bytes."""
        return self.dtype.itemsize * math.prod(self.shape)


def save_arrays(path: Path, arrays: Arrays, facts: dict[str, Any] | None = None) -> None:
    """Write `arrays` to `path`, with a checksum. The same arrays and facts give the same bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        digest.update(_title(name, array.dtype, array.shape))
        digest.update(array.data if array.size else b"")
    save_file(arrays, path, {HEADER: _about(digest.hexdigest(), facts)})


def save_parts(
    path: Path, parts: Iterable[Arrays], rows: int, facts: dict[str, Any] | None = None
) -> None:
    """Write float32 arrays that come part by part; the same bytes as `save_arrays` of the whole.

    No more than one part is in memory, and `parts` may be made on the way.

    Args:
        path: the file.
        parts: the next rows (first axis) of every array.
        rows: of all parts together.
        facts: about the arrays.

    Raises:
        ValueError: the parts do not fit together, or are not `rows` rows.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb+") as file:
        places: dict[str, Place] = {}
        shapes: dict[str, tuple[int, ...]] = {}
        done = 0
        for part in parts:
            if not places:
                shapes = {name: (rows, *array.shape[1:]) for name, array in part.items()}
                places = _write_header(file, shapes, _about(NO_CHECKSUM, facts))
            (length,) = {len(array) for array in part.values()}
            if done + length > rows or {n: (rows, *a.shape[1:]) for n, a in part.items()} != shapes:
                raise ValueError(f"{path}: rows {done} to {done + length} do not fit the file")
            for name, array in part.items():
                place = places[name]
                file.seek(place.start + done * (place.size // rows))
                file.write(np.ascontiguousarray(array, place.dtype).data if array.size else b"")
            done += length
        if done != rows:
            raise ValueError(f"{path}: {done} of {rows} rows")
        # The header is first, and as long whatever the checksum: until here, it is a wrong one.
        _write_header(file, shapes, _about(_checksum(file, places), facts))


def load_arrays(path: Path) -> tuple[Arrays, dict[str, Any]]:
    """The arrays in `path`, and the facts about them.

    They are checked as a whole, then mapped: memory is taken for what is looked at, and the system
    can take it back. What is written into them does not reach the file.

    Raises:
        StudyError: the file is missing, is no whole file of ours, or is not what was written.
    """
    try:
        places, header = _read_header(path)
        with path.open("rb") as file:
            found = _checksum(file, places)
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
    except (OSError, SafetensorError, ValueError, KeyError) as error:
        raise StudyError(f"cannot read {path}: {error}") from error
    if header.get("sha256") != found or "facts" not in header:
        raise StudyError(f"{path} is damaged: its numbers are not those that were written")
    arrays: Arrays = {
        name: np.ndarray(place.shape, place.dtype, mapped, place.start)
        for name, place in places.items()
    }
    return arrays, header["facts"]


def load_parts(path: Path, name: str, rows: int) -> Iterator[Array]:
    """One array, `rows` of its first axis at a time; no more is in memory. It is not checked."""
    place = _read_header(path)[0][name]
    row = np.dtype((place.dtype, place.shape[1:]))
    with path.open("rb") as file:
        file.seek(place.start)
        for start in range(0, place.shape[0], rows):
            yield np.fromfile(file, row, min(rows, place.shape[0] - start))


def _about(checksum: str, facts: dict[str, Any] | None) -> str:
    # One header entry only: safetensors does not keep the order of several.
    return json.dumps({"sha256": checksum, "facts": facts or {}}, sort_keys=True)


def _write_header(
    file: BinaryIO, shapes: Mapping[str, tuple[int, ...]], about: str
) -> dict[str, Place]:
    """The header that safetensors writes for float32 arrays of these shapes, and where they go."""
    dtype = np.dtype(TYPES["F32"])
    entries: dict[str, Any] = {"__metadata__": {HEADER: about}}
    start = 0
    for name, shape in sorted(shapes.items()):
        end = start + dtype.itemsize * math.prod(shape)
        entries[name] = {"dtype": "F32", "shape": list(shape), "data_offsets": [start, end]}
        start = end
    text = json.dumps(entries, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 8)
    file.seek(0)
    file.write(len(text).to_bytes(8, "little") + text)
    return _places(entries, file.tell())


def _read_header(path: Path) -> tuple[dict[str, Place], dict[str, Any]]:
    """Where the arrays are, and our own entry."""
    with safe_open(path, framework="np") as checked:  # the header is sound, the file as long
        header = json.loads((checked.metadata() or {}).get(HEADER, "{}"))
    with path.open("rb") as file:
        entries = json.loads(file.read(int.from_bytes(file.read(8), "little")))
        return _places(entries, file.tell()), header


def _places(entries: Mapping[str, Any], base: int) -> dict[str, Place]:
    return {
        name: Place(
            np.dtype(TYPES[entry["dtype"]]),
            tuple(entry["shape"]),
            base + entry["data_offsets"][0],
        )
        for name, entry in entries.items()
        if name != "__metadata__"
    }


def _checksum(file: BinaryIO, places: Mapping[str, Place]) -> str:
    """SHA-256 of names, types, shapes and numbers, as they are in the file."""
    digest = hashlib.sha256()
    for name, place in sorted(places.items()):
        digest.update(_title(name, place.dtype, place.shape))
        file.seek(place.start)
        left = place.size
        while left:
            piece = file.read(min(left, PIECE))
            if not piece:
                raise ValueError("the file is too short")
            digest.update(piece)
            left -= len(piece)
    return digest.hexdigest()


def _title(name: str, dtype: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    return f"{name} {dtype.str} {shape};".encode()
