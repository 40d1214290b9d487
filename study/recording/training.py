"""``training.rrd``: a Lightning logger that writes the curves of a fit to a Rerun recording."""

import contextlib
import json
from argparse import Namespace
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any
from uuid import uuid4

import rerun as rr
from lightning.fabric.utilities.logger import _convert_params, _flatten_dict
from lightning.pytorch.loggers.logger import Logger
from lightning.pytorch.utilities import rank_zero_only

from study.plotting.palette import series
from study.recording import blueprints
from study.recording.integrity import writing
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

Each curve is a number that was logged while the model was fitted, by step of the optimiser. Hover
over a curve to read a number, drag to zoom, and double-click to see the whole curve.

- *Loss*: what the optimiser minimises on the training data.
- *Validation*: a score of forecasts on data that the model is not trained on, at each evaluation.
  Lower is better. Where it rises while the loss still falls, the model overfits.
- *KL divergence*: how much information the latent variable of an autoencoder carries. At zero the
  latent variable is unused (posterior collapse).

The tab *Hyperparameters*, where there is one, lists the settings of the model.
"""


class RerunLogger(Logger):
    """Logs scalars by step to one Rerun recording.

    The logger collects values in memory and writes them in columns, since single rows take several
    times the bytes and the time. `finalize` writes the collected values and leaves the recording
    open, because Lightning calls it after every fit and every validation. `close`, or the end of a
    `with` block, moves the finished file to `path`.

    A pickled or copied logger has the same path and has logged nothing.

    Args:
        path: the recording; written under a temporary name until it is closed.
        application_id: Rerun's application id; recordings with the same id share a blueprint.
        recording_name: the recording's name in the viewer's list.
        properties: the properties of the recording, such as seed and settings.
        rows: the number of values of one metric that the logger collects before it writes them.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        application_id: str = "study_training",
        recording_name: str = "training",
        properties: Properties | None = None,
        rows: int = 1024,
    ) -> None:
        super().__init__()
        self.path = Path(path)
        self.application_id = application_id
        self.recording_name = recording_name
        self.properties = dict(properties or {})
        self.rows = rows
        self._stream: rr.RecordingStream | None = None
        self._temporary: Path | None = None
        self._pending: dict[str, list[tuple[int, float]]] = {}
        self._last_step: dict[str, int] = {}
        self._closed = False

    def __reduce__(self) -> tuple[Any, ...]:
        settings: dict[str, Any] = {
            "application_id": self.application_id,
            "recording_name": self.recording_name,
            "properties": self.properties,
            "rows": self.rows,
        }
        return partial(RerunLogger, self.path, **settings), ()

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
        """Rerun's application id."""
        return self.application_id

    @property
    def experiment(self) -> rr.RecordingStream:
        """The Rerun stream, for other data: `logger.experiment.log("image", rr.Image(…))`."""
        if self._closed:
            raise ValueError(f"the recording {self.path} is closed: log to a new RerunLogger")
        if self._stream is None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            # Unique, since a copy of the logger has the same path.
            self._temporary = self.path.with_name(f".{self.path.name}.{uuid4().hex[:12]}")
            self._stream = open_stream(self._temporary, self.application_id)
            write_properties(self._stream, self.recording_name, self.properties)
            write_readme(self._stream, _README, self.properties)
        return self._stream

    @rank_zero_only
    def log_metrics(self, metrics: Mapping[str, float], step: int | None = None) -> None:
        """Log one value of each metric; NaN leaves a gap in the curve.

        Args:
            metrics: the values, by name.
            step: the optimiser's step; None for the step after the metric's last one.

        Raises:
            ValueError: the recording is closed.
        """
        if self._closed:
            raise ValueError(f"the recording {self.path} is closed: log to a new RerunLogger")
        for name, value in metrics.items():
            metric_step = self._last_step.get(name, -1) + 1 if step is None else int(step)
            self._last_step[name] = metric_step
            self._pending.setdefault(name, []).append((metric_step, float(value)))
            if len(self._pending[name]) >= self.rows:
                self._write(name)

    @rank_zero_only
    def log_hyperparams(
        self, params: dict[str, Any] | Namespace, *args: Any, **kwargs: Any
    ) -> None:
        """Log the hyperparameters as a panel, and as JSON in a property."""
        flat = {key: str(value) for key, value in _flatten_dict(_convert_params(params)).items()}
        if not flat:
            return
        rows = table(("hyperparameter", "value"), list(flat.items()))
        write_markdown(self.experiment, "/hyperparameters", f"# Hyperparameters\n\n{rows}")
        self.experiment.send_property("hyperparameters", rr.AnyValues(json=json.dumps(flat)))

    @rank_zero_only
    def finalize(self, status: str) -> None:
        """Write the pending values. The recording stays open, since another fit may follow."""
        if not self._closed:
            self.flush()

    def flush(self) -> None:
        """Write the pending values to the temporary file."""
        for name in self._pending:
            self._write(name)

    @rank_zero_only
    def close(self) -> None:
        """Move the finished recording to `path`, with its checksum; a second call does nothing."""
        if self._closed:
            return
        stream = self.experiment
        self.flush()
        for index, name in enumerate(self._pending):
            style_lines(stream, _entity(name), [name], [series(index)])
        stream.send_blueprint(blueprints.training([_entity(name) for name in self._pending]))
        stream.disconnect()
        self._closed = True
        if self._temporary is not None:
            with writing(self.path) as temporary:
                self._temporary.replace(temporary)

    def _write(self, name: str) -> None:
        pending = self._pending[name]
        if pending:
            steps, values = zip(*pending, strict=True)
            send_scalars(self.experiment, _entity(name), TIMELINE, steps, values)
            pending.clear()

    def discard(self) -> None:
        """Delete the unfinished recording."""
        if self._stream is not None:
            self._stream.disconnect()
        if self._temporary is not None:
            with contextlib.suppress(OSError):
                self._temporary.unlink(missing_ok=True)
        self._closed = True


def _entity(metric: str) -> str:
    return entity_path(*(part for part in metric.split("/") if part))
