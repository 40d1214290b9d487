"""Write a recording: open and close its stream, and send columns of numbers to the stream.

The module uses no global state of Rerun, so several recordings can be open at once.
"""

import hashlib
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from struct import calcsize, unpack_from

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import ArrayLike

from study.common.arrays import Array, Doubles
from study.plotting.palette import Colour
from study.recording.integrity import writing
from study.recording.properties import Properties, write_properties

PREFIX = "study_"
"""The start of the application id of a recording."""
HEADER = 12
"""Length of the header of a recording, in bytes."""
INDEX = 0
"""The kind of the message that is the index."""


def application_id(kind: str, properties: Properties) -> str:
    """Rerun's application id of a recording, from its kind and its environment or study.

    A viewer uses the first blueprint that it receives for an application, and a blueprint names the
    state's dimensions. So two recordings have the same application exactly if they have the same
    blueprint.
    """
    shared = str(properties.get("environment", _subject(properties))).split("/")[0]
    return PREFIX + "_".join(filter(None, (kind, shared)))


def recording_id(kind: str, properties: Properties) -> str:
    """Rerun's id of a recording, from its name and a digest of its properties.

    The properties have the settings and the source. So the id is unique to the cell, the kind and
    the study, and a recording that is written again has the same id.
    """
    content = json.dumps(dict(properties), sort_keys=True, default=str)
    digest = hashlib.sha256(content.encode()).hexdigest()[:12]
    return "/".join(filter(None, (_subject(properties), kind, digest)))


def recording_name(kind: str, properties: Properties) -> str:
    """The name of a recording in the viewer: its cell, environment or study, then its kind."""
    return " · ".join(filter(None, (_subject(properties), kind)))


def _subject(properties: Properties) -> str:
    """The cell, the environment or the study of a recording."""
    names = (properties[key] for key in ("cell", "environment", "study") if key in properties)
    return str(next(names, ""))


@contextmanager
def recording(
    path: Path,
    kind: str,
    properties: Properties,
    blueprint: rrb.Blueprint,
    footer: bool = True,
) -> Iterator[rr.RecordingStream]:
    """Write the recording `path` and its checksum after the block has succeeded.

    Args:
        path: the file.
        kind: see `application_id`.
        properties: of the recording.
        blueprint: the layout in the viewer.
        footer: whether to write an index, with which a reader loads a part of a large file. It
            takes about a kilobyte for each entity.

    Raises:
        OSError: the recording cannot be written.
        StudyError: what was written cannot be read back.
    """
    stream = rr.RecordingStream(
        application_id(kind, properties),
        recording_id=recording_id(kind, properties),
        send_properties=True,
    )
    # Each row names its timeline, so Rerun's own timelines are not needed.
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    # A failing file writer of Rerun reports no error, or never returns. So the stream is in memory.
    memory = rr.binary_stream(stream)
    try:
        stream.send_blueprint(blueprint)
        write_properties(stream, recording_name(kind, properties), properties)
        yield stream
        content = memory.read() or b""
    finally:
        stream.disconnect()
    with writing(Path(path)) as temporary:
        temporary.write_bytes(content if footer else _without_footer(content))


def _without_footer(content: bytes) -> bytes:
    """A recording without its last message, the index.

    A recording is a header and then messages. A message is its kind, its length and its content.
    The index is the only message of kind 0.
    """
    position = HEADER
    while position < len(content):
        kind, length = unpack_from("<QQ", content, position)
        if kind == INDEX:
            break
        position += calcsize("<QQ") + length
    return content[:position]


def send_scalars(
    stream: rr.RecordingStream, entity: str, timeline: str, times: ArrayLike, values: ArrayLike
) -> None:
    """Send one scalar [N], or C scalars [N, C], for each of the times [N], in one message."""
    table = np.asarray(values, dtype=np.float64)
    columns = rr.Scalars.columns(scalars=table.reshape(-1))
    if table.ndim == 2:
        columns = columns.partition(np.full(len(table), table.shape[1]))
    stream.send_columns(entity, [time_column(timeline, times)], columns)


def time_column(timeline: str, times: ArrayLike) -> rr.TimeColumn:
    """The times [N] of a column, as whole numbers."""
    return rr.TimeColumn(timeline, sequence=np.asarray(times, dtype=np.int64))


def style_lines(
    stream: rr.RecordingStream,
    entity: str,
    names: Sequence[str],
    colours: Sequence[Colour],
    widths: Sequence[float] | float = 1.5,
) -> None:
    """Set the name, the colour and the line width of each series of an entity."""
    if isinstance(widths, int | float):
        widths = [widths] * len(names)
    style = rr.SeriesLines(names=list(names), colors=list(colours), widths=list(widths))
    stream.log(entity, style, static=True)


def entity_path(*parts: str) -> str:
    """An entity path from its parts, in which Rerun's special characters are escaped."""
    return str(rr.new_entity_path(list(parts)))


def entity_below(root: str, *parts: str) -> str:
    """An entity path below the entity path `root`, in which special characters are escaped."""
    return root + entity_path(*parts)


def finite(values: Array) -> Doubles:
    """A copy with NaN for each value that is not finite; Rerun leaves NaN out of a plot."""
    table = np.asarray(values, dtype=np.float64)
    return np.where(np.isfinite(table), table, np.nan)
