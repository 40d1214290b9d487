"""Commands that only read work on a folder in which nothing may be written."""

import subprocess
import sys
from pathlib import Path

import pytest

from study.workflow.lock import locked
from tests.helpers.running import ROOT, SMALL, Done, study

GUARDED = """
import os, sys
folder, *arguments = sys.argv[1:]
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
CHANGES = ("os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.truncate", "os.utime", "os.chmod")

def refuse(event, values):
    changes = event in CHANGES or event == "open" and values[2] & WRITING
    if changes and isinstance(values[0], (str, os.PathLike)):
        if os.path.abspath(values[0]).startswith(folder):
            raise PermissionError(13, "Permission denied", str(values[0]))

os.access = lambda path, mode, **_: not (mode & os.W_OK and str(path).startswith(folder))
sys.addaudithook(refuse)
from study.run import main
sys.exit(main(arguments))
"""
"""Runs a command in a process that may not change a folder, whoever runs the tests."""


def guarded(folder: Path, *arguments: object) -> Done:
    program = [sys.executable, "-c", GUARDED, str(folder), *map(str, arguments)]
    done = subprocess.run(program, cwd=ROOT, capture_output=True, encoding="utf-8", check=False)
    return Done(done.returncode, done.stdout, done.stderr)


def test_status_and_plan(copied: Path) -> None:
    (copied / ".lock").touch()
    expected = study("status", "--out", copied)
    assert expected.out.count(" done ") == 14
    assert guarded(copied, "status", "--out", copied) == expected
    plan = guarded(copied, "plan", "--out", copied)
    assert (plan.code, plan.err) == (0, "")
    assert plan.due() == {}
    assert plan.out.splitlines()[-1] == (
        "0 of 14 stages to run; results: `all` will refuse to run: no permission to write to "
        f"'{copied}', or its file system is read-only"
    )
    assert guarded(copied, "all", "--out", copied).code == 2


def test_status_sees_a_run(copied: Path) -> None:
    with locked(copied):
        done = guarded(copied, "status", *SMALL, "--out", copied)
    assert done.code == 0
    assert "(a run is going on)" in done.out


@pytest.mark.parametrize(
    "command",
    [["verify"], ["compare", "cart/low/full_vae/seed-0", "cart/low/drift/seed-0", "--out"]],
)
def test_others(copied: Path, command: list[str]) -> None:
    done = guarded(copied, *command, copied)
    assert (done.code, done.err) == (0, "")


def test_a_forecast(copied: Path, tmp_path: Path) -> None:
    given = ("forecast", "--cell", "cart/low/drift/seed-0", "--scenario", 1, "--out", copied)
    done = guarded(copied, *given, "--save", tmp_path / "a.rrd")
    assert (done.code, done.err) == (0, "")
    assert "the source" not in done.out
    refused = guarded(copied, *given, "--save", copied / "new" / "a.rrd")
    assert refused.code == 2
    assert f"--save: no permission to write to '{copied}'" in refused.err
