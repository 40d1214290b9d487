"""The pictures of recordings on the web pages: ``python -m study.recording.pictures``.

A picture shows a few views of one recording, which are legible at the width of a web page. The PNG
contains the name and the SHA-256 of the recording as text. A test compares these with the committed
results.
"""

import argparse
import io
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from uuid import uuid4

from PIL import Image

from study.common.errors import StudyError
from study.plotting.png import save_image
from study.recording.integrity import check, read_checksum
from study.recording.screenshots import Design, settled, show
from study.recording.viewer import ask, headless

FOLDER = Path(__file__).parent / "pictures"
RECORDING = "recording"
"""Keyword of the text with the recording's path below ``recordings/``."""
CHECKSUM = "recording-sha256"
"""Keyword of the text with the recording's SHA-256."""

WIDTH = 1200
"""Width of a picture in pixels."""
_BAR = 48
"""Height in pixels of the empty bar at the top of the window, which is cropped."""
_ZOOM = 3
"""Number of steps by which the viewer enlarges its text."""
_MESSAGE = 6.0
"""Seconds after which the viewer's message at its start has disappeared."""


@dataclass(frozen=True)
class Picture:
    """One picture.

    Attributes:
        name: of the PNG, without its suffix.
        recording: path of the recording below ``recordings/``.
        columns: names of the views from top to bottom, for each column from left to right. ``*`` in
            a name matches any text. Of several views that match, the first is shown.
        shares: widths of the columns, relative to one another.
        height: in pixels.
    """

    name: str
    recording: str
    columns: tuple[tuple[str, ...], ...]
    shares: tuple[float, ...]
    height: int = 560


PICTURES = (
    Picture(
        "forecast",
        "uav/low/residual_vae/seed-0/forecast.rrd",
        (
            ("Observed and forecast paths",),
            ("Probability of success so far", "Standard deviation of the position *"),
        ),
        (3, 2),
    ),
    Picture(
        "data",
        "uav/data.rrd",
        (("Paths",), ("Close-up", "Distance to the target *")),
        (3, 2),
    ),
    Picture(
        "scores",
        "uav/low/residual_vae/seed-0/scores.rrd",
        (("MMD², all dimensions", "Coverage of central intervals"), ("Reliability*",)),
        (1, 1),
    ),
    Picture(
        "study",
        "study.rrd",
        (("Pusher: MMD² of all cells",), ("UAV: MMD² of all cells",), ("Legend",)),
        (5, 5, 3),
        480,
    ),
)


def draw_picture(picture: Picture, recordings: Path, folder: Path) -> Path:
    """Write the PNG of one picture, and return its path.

    Args:
        picture: the picture.
        recordings: the folder ``recordings`` of a results folder.
        folder: folder of the PNG.

    Raises:
        StudyError: the recording is missing or damaged, it lacks a view, or the viewer cannot draw.
    """
    path = recordings / picture.recording
    check(path)
    with headless(WIDTH, _BAR + picture.height) as client:
        names, design = show(client, path)
        _arrange(design, [[_find(n, names, path) for n in c] for c in picture.columns], picture)
        for _ in range(_ZOOM):
            ask(lambda: client.run_command("ui.zoom_in_ui"))
        ask(lambda: client.set_blueprint(design, "recording"))
        settled(client)
        time.sleep(_MESSAGE)
        window = settled(client)
    texts = {RECORDING: picture.recording, CHECKSUM: read_checksum(path)}
    with Image.open(io.BytesIO(window)) as image:
        cropped = image.crop((0, _BAR, WIDTH, _BAR + picture.height))
        return save_image(cropped, folder / f"{picture.name}.png", texts=texts)


def _find(pattern: str, names: dict[str, str], path: Path) -> str:
    """The node of the first view whose name matches a pattern."""
    for node, name in names.items():
        if fnmatch(name, pattern):
            return node
    listed = ", ".join(dict.fromkeys(names.values()))
    raise StudyError(f"recording {path} has no view '{pattern}': it has {listed}")


def _arrange(design: Design, columns: Sequence[Sequence[str]], picture: Picture) -> None:
    """Replace the layout of a blueprint by columns of views, without a time panel."""
    views = {node for column in columns for node in column}
    for entity in list(design):
        # The viewer stops at a blueprint with containers or views that are not in the layout.
        is_shown = any(f"{entity}/".startswith(f"{view}/") for view in views)
        if entity.startswith(("/container/", "/view/")) and not is_shown:
            del design[entity]
    contents = [_container(design, "Vertical", column) for column in columns]
    root = _container(design, "Horizontal", contents)
    design[root]["ContainerBlueprint"]["col_shares"] = list(picture.shares)
    design["/viewport"]["ViewportBlueprint"]["root_container"] = root.removeprefix("/container/")
    design["/time_panel"]["TimePanelBlueprint"]["state"] = "Hidden"
    design["/top_panel"] = {"PanelBlueprint": {"state": "Hidden"}}


def _container(design: Design, kind: str, contents: Sequence[str]) -> str:
    """Add a container to a blueprint, and return its node."""
    node = f"/container/{uuid4()}"
    design[node] = {
        "ContainerBlueprint": {"container_kind": kind, "contents": list(contents), "visible": True}
    }
    return node


def main(arguments: Sequence[str] | None = None) -> int:
    """Write all pictures, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=Path("results/paper"))
    parser.add_argument("--to", type=Path, default=FOLDER, help="folder of the pictures")
    options = parser.parse_args(arguments)
    try:
        for picture in PICTURES:
            print(draw_picture(picture, options.results / "recordings", options.to))
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
