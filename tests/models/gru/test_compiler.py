"""C sources are compiled once, and errors are reported."""

import ctypes
import os
from pathlib import Path

import pytest

from study.models.gru import compiler

SOURCE = "int seven(void) { return 7; }\n"


@pytest.fixture
def found() -> str:
    path = compiler.find()
    if path is None:
        pytest.fail("no C compiler") if os.environ.get("CI") else pytest.skip("no C compiler")
    assert path is not None
    return path


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = tmp_path / "seven.c"
    path.write_text(SOURCE)
    return path


def test_a_source_is_compiled_once(source: Path, found: str, tmp_path: Path) -> None:
    path = compiler.build(source, found)
    assert ctypes.CDLL(str(path)).seven() == 7
    assert list((tmp_path / "cache" / "study").iterdir()) == [path]
    modified = path.stat().st_mtime_ns
    assert compiler.build(source, found) == path
    assert path.stat().st_mtime_ns == modified


def test_another_source_gives_another_library(source: Path, found: str) -> None:
    first = compiler.build(source, found)
    source.write_text(SOURCE.replace("7", "8"))
    second = compiler.build(source, found)
    assert second != first
    assert ctypes.CDLL(str(second)).seven() == 8


def test_without_a_writable_cache_the_library_is_temporary(
    source: Path, found: str, tmp_path: Path
) -> None:
    (tmp_path / "cache").write_text("a file in place of the folder")
    path = compiler.build(source, found)
    assert tmp_path not in path.parents
    assert ctypes.CDLL(str(path)).seven() == 7


def test_an_error_in_the_source_is_reported(source: Path, found: str, tmp_path: Path) -> None:
    source.write_text("int seven(void) { return }\n")
    with pytest.raises(OSError, match=r"failed: .*seven") as error:
        compiler.build(source, found)
    assert "\n" not in str(error.value)
    assert list((tmp_path / "cache" / "study").iterdir()) == []


def test_compiling_can_be_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(compiler.SWITCH, "0")
    assert compiler.find() is None
