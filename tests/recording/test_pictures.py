"""The committed pictures of recordings, and the command that draws them."""

from pathlib import Path

import pytest
from PIL import Image

from study.common.errors import StudyError
from study.common.files import sha256
from study.plotting.png import read_texts
from study.recording import pictures
from study.recording.integrity import read_checksum
from study.recording.pictures import PICTURES, Picture, draw_picture
from study.recording.tuning import record_tuning
from tests.helpers import recordings

PAPER = Path(__file__).parents[2] / "results" / "paper" / "recordings"
TUNING = Picture("tuning", "tuning.rrd", (("Score of each *",), ("README",)), (2, 1), 300)


@pytest.mark.parametrize("picture", PICTURES, ids=lambda picture: picture.name)
def test_a_committed_picture_is_of_the_committed_results(picture: Picture) -> None:
    path = pictures.FOLDER / f"{picture.name}.png"
    texts = read_texts(path)
    expected = (picture.recording, read_checksum(PAPER / picture.recording))
    found = (texts.get(pictures.RECORDING), texts.get(pictures.CHECKSUM))
    assert found == expected, f"{path.name} shows another recording: make pictures"
    with Image.open(path) as image:
        assert image.size == (pictures.WIDTH, picture.height)


def test_no_other_picture_is_committed() -> None:
    assert {path.stem for path in pictures.FOLDER.iterdir()} == {p.name for p in PICTURES}


def test_a_missing_recording_is_named(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"forecast\.rrd is missing"):
        draw_picture(PICTURES[0], tmp_path, tmp_path)


@pytest.mark.viewer
@pytest.mark.slow
def test_a_picture_shows_the_named_views_and_carries_the_checksum(tmp_path: Path) -> None:
    recordings.require_driver()
    record_tuning(tmp_path / "tuning.rrd", recordings.trials(), {})
    path = draw_picture(TUNING, tmp_path, tmp_path / "pictures")
    assert read_texts(path)[pictures.CHECKSUM] == sha256(tmp_path / "tuning.rrd")
    with Image.open(path) as image:
        assert image.size == (pictures.WIDTH, 300)
        # Green and orange dots of complete and of pruned trials.
        colours = {pixel for _, pixel in image.convert("RGB").getcolors(10**6) or []}
    assert (46, 160, 90) in colours
    assert (235, 150, 30) in colours


@pytest.mark.viewer
def test_a_view_that_is_missing_is_named(tmp_path: Path) -> None:
    recordings.require_driver()
    record_tuning(tmp_path / "tuning.rrd", recordings.trials(), {})
    absent = Picture("tuning", "tuning.rrd", (("Loss",),), (1,))
    with pytest.raises(StudyError, match=r"no view 'Loss': it has README, Score of each β"):
        draw_picture(absent, tmp_path, tmp_path)
