"""C sources are compiled once, and errors are reported."""

import ctypes
import os
from pathlib import Path

import pytest

from study.models.unroll import compiler

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
    path = compiler.build(source, compiler=found)
    assert ctypes.CDLL(str(path)).seven() == 7
    names = [path.name, f"{path.name}.sha256"]
    assert sorted(file.name for file in (tmp_path / "cache" / "study").iterdir()) == names
    modified = path.stat().st_mtime_ns
    assert compiler.build(source, compiler=found) == path
    assert path.stat().st_mtime_ns == modified


@pytest.mark.parametrize("size", [0, 1000, -1])
def test_a_damaged_library_is_compiled_again(source: Path, found: str, size: int) -> None:
    path = compiler.build(source, compiler=found)
    content = path.read_bytes()
    path.write_bytes(content[:size])
    assert compiler.build(source, compiler=found) == path
    assert path.read_bytes() == content
    assert ctypes.CDLL(str(path)).seven() == 7


@pytest.mark.parametrize("text", [None, "", "nonsense\n"])
def test_a_library_needs_its_checksum(source: Path, found: str, text: str | None) -> None:
    path = compiler.build(source, compiler=found)
    checksum = path.with_name(f"{path.name}.sha256")
    written = checksum.read_bytes()
    if text is None:
        checksum.unlink()
    else:
        checksum.write_text(text, encoding="utf-8")
    path.write_bytes(b"damaged")
    compiler.build(source, compiler=found)
    assert checksum.read_bytes() == written
    assert ctypes.CDLL(str(path)).seven() == 7


def test_another_source_gives_another_library(source: Path, found: str) -> None:
    first = compiler.build(source, compiler=found)
    source.write_text(SOURCE.replace("7", "8"))
    second = compiler.build(source, compiler=found)
    assert second != first
    assert ctypes.CDLL(str(second)).seven() == 8


def test_another_header_gives_another_library(source: Path, found: str, tmp_path: Path) -> None:
    header = tmp_path / "number.h"
    source.write_text('#include "number.h"\nint seven(void) { return NUMBER; }\n')
    values = []
    for number in (7, 8):
        header.write_text(f"#define NUMBER {number}\n")
        values.append(ctypes.CDLL(str(compiler.build(source, header, compiler=found))).seven())
    assert values == [7, 8]


def test_without_a_writable_cache_the_library_is_temporary(
    source: Path, found: str, tmp_path: Path
) -> None:
    (tmp_path / "cache").write_text("a file in place of the folder")
    path = compiler.build(source, compiler=found)
    assert tmp_path not in path.parents
    assert ctypes.CDLL(str(path)).seven() == 7


def test_an_error_in_the_source_is_reported(source: Path, found: str, tmp_path: Path) -> None:
    source.write_text("int seven(void) { return }\n")
    with pytest.raises(OSError, match=r"failed: .*seven") as error:
        compiler.build(source, compiler=found)
    assert "\n" not in str(error.value)
    assert list((tmp_path / "cache" / "study").iterdir()) == []


def test_compiling_can_be_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(compiler.SWITCH, "0")
    assert compiler.find() is None
