"""Recordings are read back as data frames."""

from pathlib import Path

import pytest

from study.common.errors import StudyError
from study.recording import reading
from study.recording.scores import record_scores
from tests.helpers import recordings


@pytest.fixture(scope="module")
def scores(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scores") / "scores.rrd"
    record_scores(path, recordings.scores(), recordings.PROPERTIES)
    return path


def test_reading_all_entities_equals_reading_each(scores: Path) -> None:
    below = reading.scalars_below(scores, "overall")
    assert list(below) == [e for e in reading.entities(scores) if e.startswith("/overall/")]
    for entity, frame in below.items():
        assert frame.equals(reading.scalars(scores, entity))
    table = recordings.scores()
    overall = table[(table.step == -1) & (table.scenario == -1)]
    read = [value for frame in below.values() for value in frame.iloc[0]]
    assert sorted(read) == sorted(overall["value"])


def test_an_entity_with_nothing_below_it_is_empty(scores: Path) -> None:
    assert reading.scalars_below(scores, "/nowhere") == {}


@pytest.mark.parametrize("content", [None, b"", b"no recording", b"RRF2 but no more"])
def test_a_file_that_is_not_a_recording_is_named_in_one_line(
    tmp_path: Path, content: bytes | None
) -> None:
    path = tmp_path / "scores.rrd"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(StudyError) as error:
        reading.properties(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)
