"""What a machine lacks is said in one line, before any work."""

from pathlib import Path

import pytest
import torch

from study.commands import machine
from study.common.errors import BadInput
from tests.helpers.running import SMOKE, study


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--train.accelerator", "gpu"], "train.accelerator: got 'gpu'"),
        (["--evaluate.samples", "10000"], "evaluate.samples: got 10000, which needs"),
        (["--collect.rollouts", "10000"], "collect.rollouts: got 10000, which needs"),
        (["--tune.samples", "10000"], "tune.samples: got 10000, which needs"),
    ],
)
def test_it_is_said_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flags: list[str], message: str
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: False)
    monkeypatch.setattr(machine, "memory_size", lambda: 2**23)
    done = study("all", *SMOKE, *flags, "--out", tmp_path / "out")
    assert (done.code, done.out, done.err.count("\n")) == (2, "", 1)
    assert message in done.err
    assert list(tmp_path.iterdir()) == []


def test_what_fits_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "memory_size", lambda: 2**30)
    most = 2**30 // (machine.COPIES * machine.FLOAT * 100)
    machine.check_samples("--samples", most, 100)
    with pytest.raises(BadInput, match=f"at most {most} on this machine"):
        machine.check_samples("--samples", most + 1, 100)
