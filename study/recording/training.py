"""A Lightning logger that writes a Rerun recording."""

import contextlib
import json
from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import rerun as rr
from lightning.fabric.utilities.logger import _convert_params, _flatten_dict
from lightning.pytorch.loggers.logger import Logger
from lightning.pytorch.utilities import rank_zero_only

from study.plotting.palette import series
from study.recording import blueprints
from study.recording.integrity import complete, temporary_path
from study.recording.properties import (
    Properties,
    table,
    write_markdown,
    write_properties,
    write_readme,
)
from study.recording.streams import entity_path, open_stream, send_scalars, style_lines

TIMELINE = "step"
_README = """
# Training

Every curve that was logged while the model was fitted, by step of the optimiser. Move the time
cursor, or hover over a curve, to read a number; drag to zoom, double click to see all.

A validation curve has one value for each look at the validation data. Where it turns upwards while
the training loss still falls, the model has begun to learn its data by heart.
"""


class RerunLogger(Logger):
    """Scalars by step, in one Rerun recording.

    Rows are kept in memory and written in columns, since a row of its own costs several times the
    bytes and the time. `finalize` writes what is kept but leaves the recording open, because
    Lightning calls it after every fit and every validate; `close`, or the end of a `with` block,
    moves the finished file to `path`.

    A pickled or copied logger is a logger of the same path that has logged nothing yet.

    Args:
        path: the recording; written under a temporary name until it is closed.
        application_id: Rerun's id of the application; recordings with one id share a blueprint.
        recording_name: how the viewer lists the recording.
        properties: the recording's properties (cell, seed, config as JSON …).
        prefix: put before every metric's name, as a folder; may be changed between two fits.
        rows: how many rows of one metric are kept before they are written.
        readme: what the recording's README panel says, in Markdown.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        application_id: str = "study_training",
        recording_name: str = "training",
        properties: Properties | None = None,
        prefix: str = "",
        rows: int = 1024,
        readme: str = _README,
    ) -> None:
        super().__init__()
        self.path = Path(path)
        self.application_id = application_id
        self.recording_name = recording_name
        self.properties = dict(properties or {})
        self.prefix = prefix
        self.rows = rows
        self.readme = readme
        self._begin()

    def _begin(self) -> None:
        self._stream: rr.RecordingStream | None = None
        self._temporary: Path | None = None
        self._kept: dict[str, list[tuple[int, float]]] = {}
        self._last: dict[str, int] = {}
        self._closed = False

    def __getstate__(self) -> dict[str, Any]:
        state = self.__dict__.copy()
        for name in ("_stream", "_temporary", "_kept", "_last", "_closed"):
            state.pop(name)
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._begin()

    def __enter__(self) -> "RerunLogger":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close() if kind is None else self.discard()

    @property
    def name(self) -> str:
        """The recording's name."""
        return self.recording_name

    @property
    def version(self) -> str:
        """The application's id."""
        return self.application_id

    @property
    def experiment(self) -> rr.RecordingStream:
        """The Rerun stream, to log anything else: `logger.experiment.log("image", rr.Image(…))`."""
        if self._closed:
            raise ValueError(f"the recording {self.path} is closed")
        if self._stream is None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._temporary = temporary_path(self.path)
            self._stream = open_stream(self._temporary, self.application_id)
            write_properties(self._stream, self.recording_name, self.properties)
            write_readme(self._stream, self.readme, self.properties)
        return self._stream

    @rank_zero_only
    def log_metrics(self, metrics: Mapping[str, float], step: int | None = None) -> None:
        """Keep one value of each metric; NaN leaves a gap in the curve.

        Without a step the value follows the last one of its metric.
        """
        if self._closed:
            raise ValueError(f"the recording {self.path} is closed")
        for metric, value in metrics.items():
            name = f"{self.prefix}/{metric}" if self.prefix else metric
            at = self._last.get(name, -1) + 1 if step is None else int(step)
            self._last[name] = at
            self._kept.setdefault(name, []).append((at, float(value)))
            if len(self._kept[name]) >= self.rows:
                self._write(name)

    @rank_zero_only
    def log_hyperparams(
        self, params: dict[str, Any] | Namespace, *args: Any, **kwargs: Any
    ) -> None:
        """Show the hyperparameters in a panel of their own, and keep them as JSON in a property."""
        flat = {key: str(value) for key, value in _flatten_dict(_convert_params(params)).items()}
        if not flat:
            return
        rows = table(("hyperparameter", "value"), list(flat.items()))
        write_markdown(self.experiment, "/hyperparameters", f"# Hyperparameters\n\n{rows}")
        self.experiment.send_property("hyperparameters", rr.AnyValues(json=json.dumps(flat)))

    @rank_zero_only
    def finalize(self, status: str) -> None:
        """Write what is kept. The recording stays open: another fit may follow."""
        if not self._closed:
            self.flush()

    def flush(self) -> None:
        """Write what is kept in memory to the temporary file."""
        for name in self._kept:
            self._write(name)

    @rank_zero_only
    def close(self) -> None:
        """Finish the recording and move it to `path`, with its checksum; again does nothing."""
        if self._closed:
            return
        stream = self.experiment
        self.flush()
        for index, name in enumerate(self._kept):
            style_lines(stream, _entity(name), [name], [series(index)])
        stream.send_blueprint(blueprints.training([_entity(name) for name in self._kept]))
        stream.disconnect()
        self._closed = True
        if self._temporary is not None:
            complete(self._temporary, self.path)

    def _write(self, name: str) -> None:
        kept = self._kept[name]
        if kept:
            steps, values = zip(*kept, strict=True)
            send_scalars(self.experiment, _entity(name), TIMELINE, steps, values)
            kept.clear()

    def discard(self) -> None:
        """Give the recording up: nothing is left of it."""
        if self._stream is not None:
            self._stream.disconnect()
        if self._temporary is not None:
            with contextlib.suppress(OSError):
                self._temporary.unlink(missing_ok=True)
        self._closed = True


def _entity(metric: str) -> str:
    return entity_path(*(part for part in metric.split("/") if part))
