"""Reading recordings back: scalars as data frames, properties as a dictionary, panels as text."""

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
from rerun.chunk import RrdReader

from study.recording.properties import GROUP

_SCALARS = "Scalars:scalars"
_NAMES = "SeriesLines:names"
_TEXT = "TextDocument:text"


def entities(path: Path) -> list[str]:
    """Every entity path of a recording, sorted, without those of Rerun itself."""
    paths = {chunk.entity_path for chunk in _chunks(path)}
    return sorted(name for name in paths if not name.startswith("/__"))


def scalars(path: Path, entity: str) -> pd.DataFrame:
    """The scalars of one entity [N, C], indexed by their timeline, in the order of time.

    A single series is the column `value`; several have the names that the plot gives them.
    """
    return _frames(_chunks(path, entity))[entity]


def scalars_below(path: Path, entity: str) -> dict[str, pd.DataFrame]:
    """The scalars of all entities below one, by entity, as `scalars` gives them."""
    return _frames(_chunks(path, f"{entity}/**"))


def properties(path: Path) -> dict[str, str | int | float]:
    """The properties that a recording was written with."""
    values: dict[str, str | int | float] = {}
    for chunk in _chunks(path, f"/__properties/{GROUP}"):
        batch = chunk.to_record_batch()
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            if not name.startswith("rerun."):
                values[name] = column.to_pylist()[-1][0]
    return values


def document(path: Path, entity: str) -> str:
    """The Markdown of a panel."""
    for chunk in _chunks(path, entity):
        batch = chunk.to_record_batch()
        if _TEXT in batch.schema.names:
            return str(batch.column(_TEXT).to_pylist()[0][0])
    raise KeyError(entity)


def _chunks(path: Path, entity: str | None = None) -> Iterator[Any]:
    """The chunks of a recording, or those of one entity (or pattern of entities)."""
    with warnings.catch_warnings():
        # Recordings of many small entities are written without a footer.
        warnings.filterwarnings("ignore", "RRD file has no footer")
        stream = RrdReader(path).stream()
    yield from stream if entity is None else stream.filter(content=[entity])


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
