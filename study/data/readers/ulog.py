"""PX4 ULog files: a table for each topic, with columns ``topic.field``.

The second instance of a topic is ``topic_1``. A quaternion ``topic.q[0]`` … ``topic.q[3]`` also
gives ``topic.roll``, ``topic.pitch`` and ``topic.yaw``. Messages count messages of the topic.
"""

import contextlib
import io
import re
from pathlib import Path

import numpy as np

from study.common.arrays import Array
from study.common.errors import BadInput
from study.data.readers.angles import euler
from study.data.readers.table import Table

MICROSECONDS = 1e-6
MAGIC = b"ULog\x01\x12\x35"
"""The first bytes of every ULog file."""
HEADER, MESSAGE_HEADER = 16, 3
"""Bytes of the header of a file, and of that of a message: its length and its type."""


def read(path: Path) -> list[Table]:
    """One table for each topic.

    Raises:
        BadInput: the file is truncated or damaged.
    """
    from pyulog import ULog

    _check_complete(path)
    with contextlib.redirect_stdout(io.StringIO()):  # it prints warnings
        log = ULog(str(path))
    if log.file_corruption:
        raise BadInput(f"{path}: the ULog is truncated or damaged; copy it from the vehicle again")
    tables = []
    for topic in log.data_list:
        name = topic.name + (f"_{topic.multi_id}" if topic.multi_id else "")
        columns: dict[str, Array] = {
            f"{name}.{field}": np.asarray(values)
            for field, values in topic.data.items()
            if field != "timestamp" and not field.startswith("_padding")
        }
        time = np.asarray(topic.data["timestamp"], np.float64) * MICROSECONDS
        tables.append(Table(columns | _angles(columns), time, name=name, first_row=0))
    return tables


def _check_complete(path: Path) -> None:
    """Check that a ULog file ends with a whole message; the reader ignores a part of one.

    Raises:
        BadInput: it does not, or it is no ULog file.
    """
    content = path.read_bytes()
    if not content.startswith(MAGIC):
        raise BadInput(f"{path}: it is no ULog file, which begins with 'ULog'")
    position = HEADER
    while position < len(content):
        end = position + MESSAGE_HEADER + int.from_bytes(content[position : position + 2], "little")
        if end > len(content):
            raise BadInput(
                f"{path}: the ULog is truncated: its last message begins at byte {position} and is "
                f"incomplete; copy the log again, or keep its first {position} bytes"
            )
        position = end


def _angles(columns: dict[str, Array]) -> dict[str, Array]:
    """The angles of every quaternion among the columns."""
    found: dict[str, Array] = {}
    for column in columns:
        if match := re.fullmatch(r"(.*)\.q(_\w+)?\[0\]", column):
            stem = column.removesuffix("[0]")
            parts = [columns.get(f"{stem}[{i}]") for i in range(4)]
            if all(part is not None for part in parts):
                angles = euler(*parts)  # type: ignore[arg-type]
                found |= {f"{match[1]}.{n}{match[2] or ''}": a for n, a in angles.items()}
    return found
