"""Errors of the operating system on the command line."""

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from study.commands import status
from study.run import CLOSED_PIPE, STOPPED, TERMINATED, _terminate, main
from tests.helpers.running import ROOT, SMALL


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        (errno.ENOSPC, "the disk is full"),
        (errno.EACCES, "no permission"),
        (errno.ENAMETOOLONG, "the name is too long"),
        (errno.EIO, os.strerror(errno.EIO)),
    ],
)
def test_one_line_about_an_error_of_the_system(
    number: int,
    expected: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(*_: object) -> None:
        raise OSError(number, os.strerror(number), str(tmp_path / "file"))

    monkeypatch.setattr(status, "record_tasks", fail)
    assert main(["status", "--out", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"error: {tmp_path / 'file'}: {expected}")
    assert error.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("command", ["--help", "plan", "all", "status"])
def test_a_closed_pipe_ends_it_quietly(command: str, tmp_path: Path) -> None:
    """As with `python -m study.run all | true`."""
    arguments = [] if command == "--help" else [*SMALL, "--out", str(tmp_path)]
    program = [sys.executable, "-m", "study.run", command, *arguments]
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = subprocess.run(program, stdout=writing, stderr=subprocess.PIPE, text=True)
    finally:
        os.close(writing)
    assert (done.stderr, done.returncode) == ("", CLOSED_PIPE)
    assert not (tmp_path / "work" / "collect").exists()


def test_an_interpreter_without_the_requirements() -> None:
    bare = [sys.executable, "-I", "-S", "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r})\n"]
    bare[-1] += "from study.run import main; sys.exit(main(['--help']))"
    done = subprocess.run(bare, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.startswith(f"error: {sys.executable} lacks the package '")
    assert "source .venv/bin/activate" in done.stderr
    assert done.stderr.count("\n") == 1


def test_sigterm_says_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(status, "record_tasks", lambda *_: _terminate(signal.SIGTERM, None))
    with pytest.raises(SystemExit) as ended:
        main(["status", "--out", str(tmp_path)])
    assert ended.value.code == TERMINATED
    assert capsys.readouterr().err == f"{STOPPED}\n"
