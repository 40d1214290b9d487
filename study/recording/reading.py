"""Read a recording: its properties, without the rest."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rerun.chunk import RrdReader

from study.common.errors import StudyError
from study.recording.properties import GROUP

UNREADABLE = (OSError, ValueError, KeyError, RuntimeError)
"""The errors of a file that is no recording, or a damaged one."""


def reader(path: Path) -> RrdReader:
    """A reader of a recording.

    Raises:
        RuntimeError: the file is no recording.
    """
    with warnings.catch_warnings():  # that a forecast recording has no index
        warnings.simplefilter("ignore")
        return RrdReader(path)


def read_properties(path: Path) -> Mapping[str, Any]:
    """The properties of a recording.

    Raises:
        StudyError: the file is no recording.
    """
    found: dict[str, Any] = {}
    try:
        for chunk in reader(path).stream().filter(content=f"/__properties/{GROUP}"):
            for name, values in chunk.to_record_batch().to_pydict().items():
                if values and isinstance(values[0], list) and values[0]:
                    found[name] = values[0][0]
    except UNREADABLE as error:
        raise StudyError(f"recording {path} cannot be read: {error}") from None
    return found
