"""Every kind of recording in the real viewer, without a screen: no view is empty."""

import os
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

from study.common.errors import StudyError
from study.recording import blueprints, viewer
from study.recording.data import record_data
from study.recording.forecast import record_forecast
from study.recording.scores import record_scores
from study.recording.screenshots import screenshots
from study.recording.streams import recording
from study.recording.study import record_study
from study.recording.training import record_training
from study.recording.tuning import record_tuning
from tests.helpers import recordings
from tests.recording import test_data

# An empty plot has a title, axes and a cursor on a ground of one colour: see the test of it below.
LEAST_COLOURED = 5e-4


def coloured(image: Path) -> float:
    """The share of a view's pixels, below its title, that are drawn: of text or of curves.

    A pixel counts if it differs from the view's commonest colour by more than the grid does.
    """
    pixels = plt.imread(image)[40:, :, :3]
    flat = np.round(pixels.reshape(-1, 3) * 255).astype(int)
    codes = flat @ np.array([65536, 256, 1])
    ground = int(np.bincount(codes).argmax())
    away = np.abs(flat - [ground >> 16, ground >> 8 & 255, ground & 255]).max(axis=1)
    # White-grey lettering of axes, and the cursor, have no hue; a document is all lettering.
    hue = np.ptp(flat, axis=1)
    return float(((away > 40) & (hue > 30)).mean())


def lettered(image: Path) -> float:
    """The share of bright pixels, for documents."""
    pixels = plt.imread(image)[40:, :, :3]
    return float((pixels.max(axis=-1) > 0.6).mean())


def _training(path: Path) -> None:
    steps = np.arange(50)
    curves = {"loss": pd.Series(np.exp(-steps / 10)), "loss/kl": pd.Series(steps / 50)}
    record_training(path, curves, recordings.PROPERTIES)


KINDS: dict[str, Callable[[Path], None]] = {
    "data": lambda path: record_data(
        path, recordings.Puck(), test_data.trajectories()[:2], recordings.PROPERTIES
    ),
    "training": _training,
    "tuning": lambda path: record_tuning(path, recordings.trials(), recordings.PROPERTIES),
    "scores": lambda path: record_scores(path, recordings.scores(), recordings.PROPERTIES),
    "forecast": lambda path: record_forecast(
        path, recordings.Puck(), recordings.examples(recordings.Puck(), 1), recordings.PROPERTIES
    ),
    "study": lambda path: record_study(
        path, recordings.study_scores(), recordings.TEXTS, {"study": "toy"}
    ),
}


@pytest.mark.viewer
@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_view_is_drawn(kind: str, tmp_path: Path) -> None:
    recordings.require_driver()
    path = tmp_path / f"{kind}.rrd"
    KINDS[kind](path)
    shown = screenshots(path, Path(os.environ.get("SCREENSHOTS", tmp_path / "png")))
    assert shown.problems == []
    documents = {"README", "About this scenario", "About this trajectory"}
    documents |= {"Cells", "Legend", *recordings.TEXTS}
    for name, image in shown.views.items():
        share = lettered(image) if name.split(" (")[0] in documents else coloured(image)
        assert share > LEAST_COLOURED, f"{name} is blank: {share:.1e}"


@pytest.mark.viewer
def test_an_empty_view_counts_as_blank(tmp_path: Path) -> None:
    recordings.require_driver()
    path = tmp_path / "empty.rrd"
    with recording(path, "training", {}, blueprints.training(["loss"])):
        pass
    shown = screenshots(path, tmp_path / "png")
    assert coloured(shown.views["Loss"]) < LEAST_COLOURED
    assert lettered(shown.views["README"]) < LEAST_COLOURED


def test_a_missing_driver_is_named_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record_tuning(tmp_path / "t.rrd", recordings.trials(), {})
    monkeypatch.setattr(viewer, "has_driver", lambda: False)
    with pytest.raises(StudyError, match=r"^no Vulkan driver.*mesa-vulkan-drivers\)$"):
        screenshots(tmp_path / "t.rrd", tmp_path)


@pytest.fixture
def started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file to which a viewer that fails writes its command line."""
    arguments, program = tmp_path / "arguments", tmp_path / "rerun"
    program.write_text(f'#!/bin/sh\necho "$@" > {arguments}\necho no window >&2\nexit 1\n')
    program.chmod(0o755)
    monkeypatch.setattr(viewer, "executable", lambda: str(program))
    return arguments


def test_without_a_display_it_says_so(
    started: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    record_tuning(tmp_path / "t.rrd", recordings.trials(), {})
    with pytest.raises(StudyError, match=r"^there is no display .*--save"):
        viewer.open_viewer([tmp_path / "t.rrd"])
    assert not started.exists()


def test_a_viewer_that_fails_is_one_line_and_it_listens_to_this_machine_alone(
    started: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DISPLAY", ":77")
    record_tuning(tmp_path / "t.rrd", recordings.trials(), {})
    with pytest.raises(StudyError, match=r"^the viewer does not start: no window; .*--save"):
        viewer.open_viewer([tmp_path / "t.rrd"])
    assert started.read_text().split()[:2] == ["--bind", "127.0.0.1"]


@pytest.mark.viewer
def test_the_viewer_for_screenshots_listens_to_this_machine_alone() -> None:
    recordings.require_driver()
    with viewer.headless():
        sockets = Path("/proc/net/tcp").read_text() + Path("/proc/net/tcp6").read_text()
        processes = Path("/proc/self/task").glob(f"{os.getpid()}/children")
        viewers = [child for path in processes for child in path.read_text().split()]
        owned = {
            os.readlink(link).removeprefix("socket:[").removesuffix("]")
            for child in viewers
            for link in Path(f"/proc/{child}/fd").glob("*")
        }
    rows = [line.split() for line in sockets.splitlines() if "local_address" not in line]
    listening = [row[1].split(":")[0] for row in rows if row[3] == "0A" and row[9] in owned]
    assert set(listening) == {"0100007F"}
