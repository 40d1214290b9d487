"""Reading recordings back: scalars as data frames, properties as a dict."""

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
from rerun.chunk import RrdReader

from study.common.errors import StudyError, nearest
from study.recording.properties import GROUP

_SCALARS = "Scalars:scalars"
_NAMES = "SeriesLines:names"


def entities(path: Path) -> list[str]:
    """Every entity path of a recording, sorted, without those of Rerun itself.

    Raises:
        StudyError: the file is missing or is not a recording.
    """
    paths = {chunk.entity_path for chunk in _chunks(path)}
    return sorted(name for name in paths if not name.startswith("/__"))


def scalars(path: Path, entity: str) -> pd.DataFrame:
    """The scalars of one entity [N, C], indexed by their timeline, in the order of time.

    A single series is the column `value`; several have the names that the plot gives them.

    Raises:
        StudyError: the file cannot be read, or has no scalars of that name.
    """
    entity = "/" + entity.strip("/")
    frames = _frames(_chunks(path, entity))
    if entity not in frames:
        raise StudyError(f"{path} has no scalars '{entity}': {nearest(entity, entities(path))}")
    return frames[entity]


def scalars_below(path: Path, entity: str) -> dict[str, pd.DataFrame]:
    """The scalars of an entity and of all below it, by entity, from reading the file once.

    Raises:
        StudyError: the file is missing or is not a recording.
    """
    return _frames(_chunks(path, f"/{entity.strip('/')}/**"))


def properties(path: Path) -> dict[str, str | int | float]:
    """The properties that a recording was written with.

    Raises:
        StudyError: the file is missing or is not a recording.
    """
    values: dict[str, str | int | float] = {}
    for chunk in _chunks(path, f"/__properties/{GROUP}"):
        batch = chunk.to_record_batch()
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            if not name.startswith("rerun."):
                values[name] = column.to_pylist()[-1][0]
    return values


def _chunks(path: Path, entity: str | None = None) -> Iterator[Any]:
    """The chunks of a recording, or those of one entity (or pattern of entities)."""
    if not Path(path).is_file():
        raise StudyError(f"recording {path} is missing")
    try:
        # Recordings of many small entities are written without a footer.
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "RRD file has no footer")
            reader = RrdReader(path)
        stream = reader.stream()
        yield from stream if entity is None else stream.filter(content=[entity])
    except (OSError, ValueError, RuntimeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise StudyError(f"cannot read the recording {path}: {reason}") from error


def _frames(chunks: Iterator[Any]) -> dict[str, pd.DataFrame]:
    """The scalars of all chunks, by entity path in sorted order; a column a series."""
    parts: dict[str, list[pd.DataFrame]] = {}
    names: dict[str, list[str]] = {}
    for chunk in chunks:
        batch = chunk.to_record_batch()
        if _SCALARS in batch.schema.names:
            parts.setdefault(chunk.entity_path, []).append(_frame(batch))
        elif _NAMES in batch.schema.names:
            names[chunk.entity_path] = batch.column(_NAMES).to_pylist()[-1]
    frames = {}
    for entity in sorted(parts):
        frame = pd.concat(parts[entity]).sort_index(kind="stable")
        if frame.shape[1] == 1:
            frame.columns = pd.Index(["value"])
        elif len(names.get(entity, ())) == frame.shape[1]:
            frame.columns = pd.Index(names[entity])
        frames[entity] = frame
    return frames


def _frame(batch: pa.RecordBatch) -> pd.DataFrame:
    """The scalars of one chunk: a row a time, a column a scalar."""
    timelines = [f.name for f in batch.schema if (f.metadata or {}).get(b"rerun:kind") == b"index"]
    index = pd.Index(batch.column(timelines[0]).to_pylist(), name=timelines[0])
    return pd.DataFrame(batch.column(_SCALARS).to_pylist(), index=index)
