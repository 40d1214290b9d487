"""A recording is complete, or a check says what is wrong with it."""

from pathlib import Path

import pytest

from study.common.errors import StudyError
from study.recording.integrity import check, writing


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "a.rrd"
    with writing(path) as temporary:
        temporary.write_bytes(b"recorded")
    return path


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ("truncated", "a.rrd is damaged"),
        ("flipped", "a.rrd is damaged"),
        ("empty", "a.rrd is empty"),
        ("missing", "a.rrd is missing"),
        ("no checksum", "a.rrd has no checksum: a.rrd.sha256 is missing"),
        ("empty checksum", "a.rrd has no checksum: a.rrd.sha256 is damaged"),
    ],
)
def test_damage_is_found_and_named(path: Path, damage: str, message: str) -> None:
    check(path)
    checksum = path.with_name("a.rrd.sha256")
    if damage == "truncated":
        path.write_bytes(path.read_bytes()[:-1])
    elif damage == "flipped":
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "missing":
        path.unlink()
    elif damage == "no checksum":
        checksum.unlink()
    else:
        checksum.write_text("")
    with pytest.raises(StudyError) as error:
        check(path)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_failed_write_leaves_the_old_file(path: Path) -> None:
    def fail() -> None:
        with writing(path) as temporary:
            temporary.write_bytes(b"half of the n")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert path.read_bytes() == b"recorded"
    check(path)
    assert sorted(p.name for p in path.parent.iterdir()) == ["a.rrd", "a.rrd.sha256"]
