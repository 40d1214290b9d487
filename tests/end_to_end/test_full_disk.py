"""What the system does not take is an error, and nothing that was cut off gets a checksum."""

import resource
import subprocess
import sys
from pathlib import Path

import pytest

from study.common.read_back import why_incomplete
from tests.helpers.running import ROOT, SMALL

LIMIT = 60 * 1024
"""Bytes of a file, as `ulimit -f 60` has it: less than the recordings of the study need."""


@pytest.mark.slow
def test_recordings_that_are_too_large_fail_by_name(copied: Path) -> None:
    for folder in (copied / "work" / "record").iterdir():
        for path in folder.glob("*.rrd"):
            path.unlink()
    done = subprocess.run(
        [sys.executable, "-m", "study.run", "all", *SMALL, "--out", str(copied)],
        cwd=ROOT,
        capture_output=True,
        encoding="utf-8",
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT, LIMIT)),
    )
    assert done.returncode == 1
    assert "FAILED" in done.stdout
    assert "File too large" in done.stdout
    assert "Traceback" not in done.stdout + done.stderr
    files = [path for path in copied.rglob("*") if path.is_file() and path.name[0] != "."]
    assert {path.name: why_incomplete(path) for path in files if why_incomplete(path)} == {}
    assert all(path.stat().st_size != LIMIT for path in files if path.suffix == ".rrd")
