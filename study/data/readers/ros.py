"""ROS 1 and ROS 2 bags, and MCAP files: a table for each topic, with columns ``topic.field``.

Nested fields are joined by dots, and elements of short arrays are ``field[0]``, ``field[1]``, …. An
orientation also gives ``roll``, ``pitch`` and ``yaw`` beside its field. The time is that of the
header, or else that at which the message was received. Messages count messages of the topic.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from study.common.arrays import Array
from study.common.errors import BadInput
from study.data.readers.angles import euler
from study.data.readers.table import Table

LONGEST_ARRAY = 32
"""Longer arrays, such as images and point clouds, are left out."""


def read(path: Path) -> list[Table]:
    """One table for each topic with numbers.

    Raises:
        BadInput: a part of a ROS 2 bag lacks the ``metadata.yaml`` of the bag beside it.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    folder = path.parent if path.suffix == ".db3" else path
    if folder != path and not (folder / "metadata.yaml").is_file():
        raise BadInput(f"{path}: its folder has no metadata.yaml; give the whole ROS 2 bag")
    rows: dict[str, list[dict[str, float]]] = {}
    times: dict[str, list[float]] = {}
    with AnyReader([folder], default_typestore=get_typestore(Stores.LATEST)) as reader:
        for connection, received, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            topic = connection.topic.strip("/").replace("/", ".")
            rows.setdefault(topic, []).append(dict(_numbers(message, "")))
            times.setdefault(topic, []).append(_time(message, received))
    return [table for topic in rows if (table := _table(topic, rows[topic], times[topic]))]


def _table(topic: str, rows: list[dict[str, float]], times: list[float]) -> Table | None:
    names = list(dict.fromkeys(name for row in rows for name in row))
    if not names:
        return None
    columns: dict[str, Array] = {
        f"{topic}{name}": np.array([row.get(name, np.nan) for row in rows]) for name in names
    }
    for name in names:
        if name.endswith("orientation.w"):
            stem = f"{topic}{name.removesuffix('w')}"
            parts = [columns[f"{stem}{part}"] for part in "wxyz"]
            prefix = stem.removesuffix("orientation.")
            columns |= {f"{prefix}{angle}": values for angle, values in euler(*parts).items()}
    return Table(columns, np.asarray(times, np.float64), name=topic, first_row=0)


def _time(message: Any, received: int) -> float:
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is not None and (stamp.sec or stamp.nanosec):
        return float(stamp.sec) + 1e-9 * float(stamp.nanosec)
    return 1e-9 * received


def _numbers(value: Any, name: str) -> Iterator[tuple[str, float]]:
    """The numbers in a message, by the path of their field."""
    if isinstance(value, bool | int | float | np.number):
        yield name, float(value)
    elif isinstance(value, np.ndarray | list | tuple):
        if len(value) <= LONGEST_ARRAY:
            for index, item in enumerate(value):
                yield from _numbers(item, f"{name}[{index}]")
    elif hasattr(value, "__dataclass_fields__"):
        for field in value.__dataclass_fields__:
            if field not in ("header", "__msgtype__"):
                yield from _numbers(getattr(value, field), f"{name}.{field}")
