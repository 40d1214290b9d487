"""A recording is complete, or a check says what is wrong with it."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest
import rerun.blueprint as rrb

from study.common.errors import StudyError
from study.common.files import sha256, write_checksums
from study.recording.integrity import check, checksum_path, writing
from study.recording.streams import recording, send_scalars


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "a.rrd"
    with recording(path, "test", {}, rrb.Blueprint()) as stream:
        send_scalars(stream, "numbers", "step", range(9), range(9))
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

    content = path.read_bytes()
    with pytest.raises(RuntimeError):
        fail()
    assert path.read_bytes() == content
    check(path)
    assert sorted(p.name for p in path.parent.iterdir()) == ["a.rrd", "a.rrd.sha256"]


def test_what_is_no_recording_gets_no_checksum(path: Path) -> None:
    content = path.read_bytes()
    with pytest.raises(StudyError, match=r"a\.rrd was not written completely"):  # noqa: SIM117
        with writing(path) as temporary:
            temporary.write_bytes(content[:-100])
    assert path.read_bytes() == content
    check(path)


def test_a_recording_that_was_cut_off_before_its_checksum_is_damaged(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])
    write_checksums(checksum_path(path), {path.name: sha256(path)})
    with pytest.raises(StudyError, match="damaged, though its checksum matches"):
        check(path)


LIMITED = """
import resource, sys
from pathlib import Path
import rerun.blueprint as rrb
from study.recording.streams import recording, send_scalars
resource.setrlimit(resource.RLIMIT_FSIZE, (40960, 40960))
with recording(Path(sys.argv[1]), "test", {}, rrb.Blueprint(), footer=sys.argv[2] == "1") as stream:
    send_scalars(stream, "numbers", "step", range(9000), range(9000))
"""


@pytest.mark.parametrize("footer", ["0", "1"])
def test_what_the_system_does_not_take_is_an_error(tmp_path: Path, footer: str) -> None:
    """As with `ulimit -f 40`, or on a full disk."""
    program = [sys.executable, "-c", LIMITED, str(tmp_path / "a.rrd"), footer]
    done = subprocess.run(program, capture_output=True, encoding="utf-8", check=False)
    assert done.returncode
    assert os.strerror(errno.EFBIG) in done.stderr.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []
