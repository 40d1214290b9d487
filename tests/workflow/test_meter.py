"""What a task costs, as it is measured."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from study.workflow import meter
from study.workflow.meter import Meter

MEGABYTE = 1_000_000


def test_the_peak_is_that_of_the_work(tmp_path: Path) -> None:
    """In a process of its own: whatever it held before is no part of it."""
    script = """
import numpy as np
from study.workflow.meter import Meter
before = np.ones(40_000_000); del before
meter = Meter(); small = meter.read()["peak_memory"]
during = np.ones(10_000_000); del during
print(small, meter.read()["peak_memory"])
"""
    if not meter._reset_peak():
        pytest.skip("this system does not tell the peak memory of a part of a process's life")
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    small, large = map(int, done.stdout.split())
    assert small < 200 * MEGABYTE
    assert large == pytest.approx(small + 80 * MEGABYTE, abs=8 * MEGABYTE)


def test_no_peak_where_the_system_does_not_tell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("study.workflow.meter.CLEAR", tmp_path / "nowhere" / "clear_refs")
    meter = Meter()
    np.random.default_rng(0).random((300, 300)).dot(np.ones((300, 300)))
    used = meter.read()
    assert set(used) == {"seconds", "cpu_seconds"}
    assert min(used.values()) > 0
