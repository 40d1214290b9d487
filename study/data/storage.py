"""Named arrays in one file: safetensors, with the facts about them in its header."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from study.errors import StudyError

Arrays = dict[str, NDArray[Any]]
HEADER = "study"


def save_arrays(path: Path, arrays: Arrays, facts: dict[str, Any] | None = None) -> None:
    """Write `arrays` to `path`, with a checksum. The same arrays and facts give the same bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    # One header entry only: safetensors does not keep the order of several.
    header = {"sha256": _checksum(arrays), "facts": facts or {}}
    save_file(arrays, path, {HEADER: json.dumps(header, sort_keys=True)})


def load_arrays(path: Path) -> tuple[Arrays, dict[str, Any]]:
    """The arrays in `path`, and the facts about them.

    Raises:
        StudyError: the file is missing, is no whole file of ours, or is not what was written.
    """
    try:
        with safe_open(path, framework="np") as file:
            arrays = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
            header = json.loads((file.metadata() or {}).get(HEADER, "{}"))
    except (OSError, SafetensorError, ValueError) as error:
        raise StudyError(f"cannot read {path}: {error}") from error
    if header.get("sha256") != _checksum(arrays):
        raise StudyError(f"{path} is damaged: its numbers are not those that were written")
    return arrays, header["facts"]


def _checksum(arrays: Arrays) -> str:
    """SHA-256 of names, types, shapes and numbers."""
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype.str} {array.shape};".encode())
        digest.update(array.data if array.size else b"")
    return digest.hexdigest()
