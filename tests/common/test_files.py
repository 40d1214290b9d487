"""Files that are complete or absent."""

from pathlib import Path

import pytest

from study.common.files import copy, read_checksums, replacing, sha256, write_checksums, write_json


def test_a_file_is_replaced_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "new" / "file"
    for text in ("first", "second"):
        with replacing(path, sync=True) as temporary:
            assert temporary.parent == path.parent
            temporary.write_text(text)
            assert not path.exists() or path.read_text() == "first"
        assert path.read_text() == text
    assert list(path.parent.iterdir()) == [path]


def test_a_failure_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("old")

    def fail() -> None:
        with replacing(path) as temporary:
            temporary.write_text("half of the ne")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_a_killed_process_left_is_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "file"
    with replacing(path) as temporary:
        temporary.write_text("new")
        left = temporary
    left.write_text("a longer text that a killed process left")
    copy(path, tmp_path / "other")
    write_json(path, {})
    assert path.read_text() == "{}\n"
    assert not left.exists()


def test_checksums_are_read_as_they_were_written(tmp_path: Path) -> None:
    path, file = tmp_path / "SHA256SUMS", tmp_path / "a name  with spaces"
    file.write_text("content")
    checksums = {file.name: sha256(file)}
    write_checksums(path, checksums)
    assert read_checksums(path) == checksums
    assert path.read_text() == f"{sha256(file)}  {file.name}\n"


@pytest.mark.parametrize("text", ["", "nonsense\n"])
def test_a_file_without_checksums(tmp_path: Path, text: str) -> None:
    path = tmp_path / "SHA256SUMS"
    path.write_text(text)
    with pytest.raises(ValueError):
        read_checksums(path)
