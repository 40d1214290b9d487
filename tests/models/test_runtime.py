"""The manifest and the timings say what a task has used."""

from collections.abc import Iterator

import pytest
import torch

from study.models import runtime as module
from study.models.runtime import forget_uses, report_use, runtime, uses

CPU, CUDA = torch.device("cpu"), torch.device("cuda", 0)


@pytest.fixture(autouse=True)
def new_task(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A task on a machine with a GPU."""
    monkeypatch.setattr(module, "_processor", lambda: "EPYC")
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "H100")
    forget_uses()
    yield
    forget_uses()


@pytest.mark.parametrize(
    ("used", "short", "device"),
    [
        ([], "", "EPYC"),
        ([(CPU, "32")], "cpu", "EPYC"),
        ([(CPU, "bf16")], "cpu bf16", "EPYC, bfloat16"),
        ([(CUDA, "32")], "cuda", "EPYC, H100"),
        ([(CUDA, "bf16"), (CPU, "32")], "cpu, cuda bf16", "EPYC, H100, bfloat16"),
    ],
)
def test_what_a_task_has_used(
    used: list[tuple[torch.device, str]], short: str, device: str
) -> None:
    for candidate, precision in used:
        report_use(candidate, precision)
    assert (uses(), runtime()["device"]) == (short, device)
    forget_uses()
    assert (uses(), runtime()["device"]) == ("", "EPYC")
