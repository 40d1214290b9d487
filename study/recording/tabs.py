"""The tabs of a recording's layout, and a layout that opens one of them.

A link to the viewer can select an entity or a time, but not a tab. So a layout with another open
tab is sent along with the recording.
"""

import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from uuid import UUID

import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import Chunk

from study.common.errors import StudyError
from study.recording.reading import UNREADABLE, reader

_CONTENTS, _KIND = "ContainerBlueprint:contents", "ContainerBlueprint:container_kind"
_TEXT = "TextDocument:text"
_SCENARIO = re.compile(r"# (?P<title>[^\n]+)\s+Scenario (?P<number>\d+) of the test set")
_NAMES = ("ContainerBlueprint:display_name", "ViewBlueprint:display_name")
_TABS = rrb.components.ContainerKind.Tabs.value
_ROOT = "ViewportBlueprint:root_container"


class Layout(rrb.Blueprint):
    """The layout of a recording.

    Attributes:
        application: Rerun's application id.
        tabs: the title of each tab, in their order; empty without tabs.
    """

    def __init__(self, path: Path) -> None:
        """Read the layout.

        Raises:
            StudyError: the file is no recording, or has no layout.
        """
        try:
            file = reader(path)
            (store, *_) = file.blueprints()
            self._chunks: Sequence[Chunk] = file.stream(store=store).to_chunks()
            values = {chunk.entity_path: _values(chunk) for chunk in self._chunks}
            self._root = f"container/{UUID(bytes=bytes(values['/viewport'][_ROOT]))}"
            root = values[f"/{self._root}"]
            self._contents = list(root[_CONTENTS])
        except UNREADABLE as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise StudyError(f"recording {path} has no layout: {reason}") from None
        self.application = store.application_id
        titles = [_name(values.get(f"/{content}", {})) for content in self._contents]
        self.tabs = titles if root[_KIND] == [_TABS] else []
        self._open = 0

    def opened(self, tab: int) -> bytes:
        """The content of a layout file (.rbl) in which a tab is open."""
        self._open = tab
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "layout.rbl"
            self.save(self.application, path)
            return path.read_bytes()

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        """Write the layout, and then the tab that is open; `save` calls this."""
        stream.send_chunks(self._chunks)
        tab = rrb.archetypes.ContainerBlueprint(
            container_kind=_TABS,
            contents=self._contents,
            active_tab=self._contents[self._open],
        )
        stream.log(self._root, tab)


def scenario_numbers(path: Path) -> dict[str, int]:
    """The number in the test set of each scenario of a forecast recording, by its title.

    Raises:
        StudyError: the file is no recording.
    """
    numbers = {}
    try:
        for chunk in reader(path).stream():
            if chunk.entity_path.endswith("/about"):
                ((text,),) = chunk.to_record_batch().to_pydict()[_TEXT]
                if found := _SCENARIO.match(text):
                    numbers[found["title"]] = int(found["number"])
    except UNREADABLE as error:
        raise StudyError(f"recording {path} cannot be read: {error}") from None
    return numbers


def _values(chunk: Chunk) -> dict[str, Any]:
    """The last value of each component of a chunk, without the list around it."""
    columns = chunk.to_record_batch().to_pydict()
    return {
        name: values[-1][0] if name in (*_NAMES, _ROOT) and values[-1] else values[-1]
        for name, values in columns.items()
        if ":" in name
    }


def _name(values: dict[str, Any]) -> str:
    return next((str(values[name]) for name in _NAMES if name in values), "")
