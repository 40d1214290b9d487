"""What `forecast` refuses before it forecasts."""

from pathlib import Path

import pytest

from tests.helpers.running import study

GIVEN = ("forecast", "--cell", "cart/low/drift/seed-0", "--scenario", "0", "--out")


@pytest.mark.parametrize("flag", ["--save", "--write"])
def test_a_target_that_cannot_be_written(flag: str, tmp_path: Path) -> None:
    suffix = ".rrd" if flag == "--save" else ".csv"
    file, folder = tmp_path / "file", tmp_path / f"folder{suffix}"
    file.touch()
    folder.mkdir()
    for target, problem in (
        (file / f"a{suffix}", f"'{file}' is not a folder"),
        (folder, f"{folder} is a folder; give a file"),
        (tmp_path / ("a" * 300) / f"b{suffix}", "the name is too long; give a shorter one"),
    ):
        done = study(*GIVEN, tmp_path / "study", flag, target)
        assert (done.code, done.out) == (2, "")
        assert done.err.startswith(f"error: {flag}: ")
        assert done.err.endswith(f"{problem}\n")


def test_no_display_for_the_viewer(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    done = study(*GIVEN, small)
    assert (done.code, done.out) == (1, "")
    assert "there is no display" in done.err
    assert "--save" in done.err
