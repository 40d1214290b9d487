"""Opening and closing a recording, and writing columns to it. No global Rerun state is touched."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import ArrayLike

from study.common.arrays import Array, Doubles
from study.plotting.palette import Colour
from study.recording.integrity import replacing
from study.recording.properties import Properties, write_properties


def application_id(kind: str, properties: Properties) -> str:
    """The Rerun application of a recording: one for each kind and environment, or study.

    A viewer keeps the first blueprint that it sees for an application, and a blueprint names the
    state's dimensions. So recordings share an application exactly if they share a blueprint.
    """
    shared = str(properties.get("environment", _subject(properties))).split("/")[0]
    return "_".join(filter(None, ("study", kind, shared)))


def recording_name(kind: str, properties: Properties) -> str:
    """How the recording is listed in the viewer: what it is of, and its kind."""
    return " · ".join(filter(None, (_subject(properties), kind)))


def _subject(properties: Properties) -> str:
    """What the recording is of: a cell, an environment or a whole study."""
    names = (properties[key] for key in ("cell", "environment", "study") if key in properties)
    return str(next(names, ""))


def open_stream(path: Path, application: str, footer: bool = True) -> rr.RecordingStream:
    """A stream of its own into the file `path`. Every row says on which timeline it is.

    The footer is an index for reading a part of a large file; it takes a kilobyte an entity.
    """
    stream = rr.RecordingStream(application, send_properties=True)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    stream.save(path, write_footer=footer)
    return stream


@contextmanager
def recording(
    path: Path,
    kind: str,
    properties: Properties,
    blueprint: rrb.Blueprint,
    footer: bool = True,
) -> Iterator[rr.RecordingStream]:
    """Write the recording `path`: it is there, with its checksum, once the block has succeeded."""
    with replacing(Path(path)) as temporary:
        stream = open_stream(temporary, application_id(kind, properties), footer)
        try:
            stream.send_blueprint(blueprint)
            write_properties(stream, recording_name(kind, properties), properties)
            yield stream
        finally:
            stream.disconnect()


def send_scalars(
    stream: rr.RecordingStream, entity: str, timeline: str, times: ArrayLike, values: ArrayLike
) -> None:
    """One scalar, or several [N, C], at each of the N times, in one piece."""
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
    """How the series of an entity are named and drawn."""
    each = [widths] * len(names) if isinstance(widths, int | float) else list(widths)
    style = rr.SeriesLines(names=list(names), colors=list(colours), widths=each)
    stream.log(entity, style, static=True)


def entity_path(*parts: str) -> str:
    """An entity path; any character may stand in a part."""
    return str(rr.new_entity_path(list(parts)))


def finite(values: Array) -> Doubles:
    """A copy in which whatever is not finite is NaN, which Rerun leaves out of a plot."""
    table = np.asarray(values, dtype=np.float64)
    return np.where(np.isfinite(table), table, np.nan)
