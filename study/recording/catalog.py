"""A Rerun catalog: all recordings of a study in one table that can be filtered and queried.

A recording is a *segment* of a dataset. A dataset holds the recordings with the same layout: those
of one kind and environment, such as ``forecast_uav``. Its layout is registered with it, and its
segment table has the properties of the recordings and the scores of their cells as columns.
"""

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from study.common.errors import BadInput, StudyError
from study.recording.integrity import check
from study.recording.properties import GROUP
from study.recording.reading import reader
from study.recording.streams import PREFIX
from study.recording.viewer import LOCALHOST

if TYPE_CHECKING:
    from rerun.catalog import CatalogClient, DatasetEntry

SCORES = "scores"
"""The layer of a segment that holds the scores of its cell."""
COLUMNS = {
    "cell": "cell",
    "environment": "environment",
    "level": "level",
    "model": "model",
    "seed": "seed",
    "beta": "β",
    "mmd2": "MMD²",
    "brier": "plain Brier score",
}
"""The properties that are the first columns of a segment table, with their titles."""
HIDDEN = ("config", "versions", "source_revision", "study_version")
"""The properties that are columns only on request, since they are long."""
_WITHOUT_EXTRA = "the catalog needs datafusion: pip install -e '.[catalog]'"


@dataclass(frozen=True)
class Catalog:
    """A catalog that is being served.

    Attributes:
        address: of the server, for `rerun.catalog.CatalogClient` and for the viewer.
        datasets: the number of recordings in each dataset.
        problems: one line for each recording that is not in the catalog.
    """

    address: str
    datasets: Mapping[str, int]
    problems: Sequence[str]


@dataclass(frozen=True)
class _Segment:
    """A recording that can be registered."""

    path: Path
    cell: str
    application: str
    id: str

    @property
    def address(self) -> str:
        """Of the file, for the server."""
        return _address(self.path)


@dataclass
class _Builder:
    """Registers recordings with a server."""

    client: "CatalogClient"
    folder: Path
    scores: Mapping[str, Mapping[str, float]]
    datasets: dict[str, int] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)

    def add(self, application: str, segments: Sequence[_Segment]) -> None:
        """Add a dataset with the layout of its last recording."""
        name = application.removeprefix(PREFIX)
        dataset = self.client.create_dataset(name)
        refused = self._register(dataset, [segment.path for segment in segments])
        accepted = [segment for segment in segments if segment.address not in refused]
        self.datasets[name] = len(accepted)
        if not accepted:
            return
        dataset.register_blueprint(accepted[-1].address)
        layout = self.folder / f"{name}.rbl"
        _table().save(application, layout)
        dataset.register_blueprint(layout.as_uri(), segment_table=True)
        layers = [self._write_scores(s) for s in accepted if s.cell in self.scores]
        if layers:
            self._register(dataset, layers, layer_name=SCORES)

    def _register(
        self, dataset: "DatasetEntry", paths: Sequence[Path], layer_name: str = "base"
    ) -> set[str]:
        """Register files, and return the addresses of those that the server refuses.

        `problems` gets a line for each.
        """
        addresses = {_address(path): path for path in paths}
        results = dataset.register(list(addresses), layer_name=layer_name).iter_results()
        refused = set()
        for result in results:
            if result.error:
                refused.add(result.uri)
                name, why = addresses.get(result.uri, result.uri), result.error.splitlines()[0]
                self.problems.append(f"recording {name} is not in the catalog: {why}")
        return refused

    def _write_scores(self, segment: _Segment) -> Path:
        """Write a layer with the scores of the cell of a segment."""
        path = self.folder / f"{len(list(self.folder.iterdir()))}.rrd"
        stream = rr.RecordingStream(
            segment.application, recording_id=segment.id, send_properties=False
        )
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
        memory = rr.binary_stream(stream)
        scores = self.scores[segment.cell].items()
        typed = {name: pa.array([value], pa.float64()) for name, value in scores}
        stream.send_property(GROUP, rr.AnyValues(**typed))
        path.write_bytes(memory.read() or b"")
        stream.disconnect()
        return path


@contextmanager
def catalog(
    recordings: Path, scores: Mapping[str, Mapping[str, float]], port: int = 0
) -> Iterator[Catalog]:
    """Serve the recordings below a folder on the loopback interface, for a `with` block.

    Args:
        recordings: the folder; the recordings of a cell are in the folder of its name.
        scores: numbers for the segment tables, by name, by cell.
        port: to listen on; 0 for a free one.

    Raises:
        BadInput: there are no recordings, or the port is in use.
        StudyError: the extra `catalog` is not installed, or all recordings are damaged.
    """
    if not find_spec("datafusion"):
        raise StudyError(_WITHOUT_EXTRA)
    with tempfile.TemporaryDirectory(prefix="study-catalog-") as folder, _server(port) as server:
        segments, problems = _segments(recordings)
        applications: dict[str, list[_Segment]] = {}
        for segment in segments:
            applications.setdefault(segment.application, []).append(segment)
        builder = _Builder(_client(server), Path(folder), scores, problems=problems)
        for application in sorted(applications):
            builder.add(application, applications[application])
        yield Catalog(server.url(), builder.datasets, builder.problems)


def _segments(recordings: Path) -> tuple[list[_Segment], list[str]]:
    """The recordings that are complete, and one line for each other one."""
    paths = sorted(recordings.rglob("*.rrd"))
    if not paths:
        raise BadInput(f"there are no recordings in {recordings}: run python -m study.run all")
    segments: list[_Segment] = []
    problems = []
    for path in paths:
        try:
            check(path)
        except StudyError as error:
            problems.append(str(error))
            continue
        store = reader(path).recordings()[0]
        cell = path.parent.relative_to(recordings).as_posix()
        segments.append(_Segment(path, cell, store.application_id, store.recording_id))
    if not segments:
        raise StudyError(f"no recording in {recordings} can be read: {problems[0]}")
    return segments, problems


def _address(path: Path) -> str:
    return path.resolve().as_uri()


@contextmanager
def _server(port: int) -> Iterator[rr.server.Server]:
    """Rerun's server on the loopback interface; by default it is open to the network."""
    try:
        server = rr.server.Server(host=LOCALHOST, port=port)
    except (OSError, OverflowError, ValueError, RuntimeError) as error:
        reason = str(error).splitlines()[0].rsplit(": ", 1)[-1]
        raise BadInput(f"--port: cannot listen on {port}: {reason}; give another") from None
    try:
        yield server
    finally:
        server.shutdown()


def _client(server: rr.server.Server) -> "CatalogClient":
    try:
        return server.client()
    except Exception as error:  # a version of datafusion that does not fit
        raise StudyError(f"{_WITHOUT_EXTRA} ({str(error).splitlines()[0]})") from None


def _table() -> rrb.TableBlueprint:
    """The layout of a segment table: links to the recordings, their cells and the scores."""
    shown = [
        rrb.table.Column("rerun_segment_id", name="recording"),
        *(
            rrb.table.Column(f"property:{GROUP}:{name}", name=title)
            for name, title in COLUMNS.items()
        ),
    ]
    hidden = [rrb.table.Column(f"property:{GROUP}:{name}", visible=False) for name in HIDDEN]
    return rrb.TableBlueprint(table_layout=rrb.table.TableLayout(columns=[*shown, *hidden]))
