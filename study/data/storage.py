"""Named arrays in one file: safetensors, with the facts about them in its header."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from study.errors import StudyError

Arrays = dict[str, NDArray[Any]]


def save_arrays(path: Path, arrays: Arrays, facts: dict[str, Any] | None = None) -> None:
    """Write `arrays` to `path`. The same arrays and facts give the same bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # One header entry only: safetensors does not keep the order of several.
    header = {"facts": json.dumps(facts or {}, sort_keys=True)}
    save_file({k: np.ascontiguousarray(v) for k, v in arrays.items()}, path, header)


def load_arrays(path: Path) -> tuple[Arrays, dict[str, Any]]:
    """The arrays in `path`, and the facts about them.

    Raises:
        StudyError: the file is missing or is not a whole safetensors file.
    """
    try:
        with safe_open(path, framework="np") as file:
            arrays = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
            return arrays, json.loads((file.metadata() or {}).get("facts", "{}"))
    except (FileNotFoundError, SafetensorError) as error:
        raise StudyError(f"cannot read {path}: {error}") from error
