"""The choice of device and precision, on a machine that may lack both."""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import torch

from study.common.errors import StudyError
from study.models.base import Model
from study.training import hardware
from study.training.data_module import InMemory
from study.training.hardware import (
    CPU,
    faster_device,
    fit_precision,
    forecast_on_faster_device,
    gpu,
    width,
)
from tests.helpers.models import model

META = torch.device("meta")


@pytest.mark.parametrize(
    ("accelerator", "has_cuda", "expected"),
    [
        ("cpu", True, None),
        ("auto", True, "cuda"),
        ("gpu", True, "cuda"),
        ("auto", False, None),
        ("gpu", False, "mps"),
    ],
)
def test_the_gpu_of_a_setting(
    accelerator: str, has_cuda: bool, expected: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: has_cuda)
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 0)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: True)
    found = gpu(accelerator)
    assert (found and found.type) == expected


def test_a_gpu_that_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: False)
    with pytest.raises(StudyError, match="got 'gpu', and torch finds none here; give auto or cpu"):
        gpu("gpu")


@pytest.fixture
def with_a_gpu(monkeypatch: pytest.MonkeyPatch) -> Callable[[dict[str, float]], None]:
    """A fake GPU, and the seconds of each device."""

    def patch(seconds: dict[str, float]) -> None:
        monkeypatch.setattr(hardware, "gpu", lambda accelerator: META)
        monkeypatch.setattr(hardware, "_seconds", lambda _, device, __: seconds[device.type])

    return patch


@pytest.mark.parametrize(("of_gpu", "expected"), [(0.1, META), (0.3, CPU)])
def test_auto_takes_the_faster_device(
    of_gpu: float,
    expected: torch.device,
    with_a_gpu: Callable[[dict[str, float]], None],
    caplog: pytest.LogCaptureFixture,
) -> None:
    with_a_gpu({"cpu": 0.2, "meta": of_gpu})
    with caplog.at_level(logging.INFO):
        assert faster_device("auto", model("full_vae"), lambda _: None) == expected
    assert f"accelerator auto: {expected} (cpu 200.0 ms, meta {1e3 * of_gpu:.1f} ms)" in caplog.text


@pytest.mark.parametrize("fails", [(META,), (CPU, META)])
def test_auto_leaves_out_a_device_that_fails(
    fails: tuple[torch.device, ...],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """If both fail, the fit on the CPU shows the error."""
    monkeypatch.setattr(hardware, "gpu", lambda accelerator: META)
    monkeypatch.setattr(hardware, "TRIAL_SECONDS", 0.0)

    def run(trained: Model) -> None:
        if trained.device in fails:
            raise torch.OutOfMemoryError("CUDA out of memory")

    assert faster_device("auto", model("full_vae"), run) == CPU
    assert "accelerator auto: not on meta: " in caplog.text
    assert "CUDA out of memory" in caplog.text


def test_a_choice_is_not_measured(with_a_gpu: Callable[[dict[str, float]], None]) -> None:
    with_a_gpu({})
    assert faster_device("gpu", model("full_vae"), lambda _: None) == META


def test_scores_are_computed_where_forecasts_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """A device without float64 computes none, and only a model is moved."""
    scenarios: Any = None
    seeds: Any = None
    network = Mock(spec=Model)
    for kind, expected in (("cuda", "cuda"), ("cpu", None), ("mps", None)):
        network.device = torch.device(kind)
        monkeypatch.setattr(hardware, "faster_device", lambda *_, device=network.device: device)
        found = forecast_on_faster_device("auto", network, scenarios, seeds)
        network.to.assert_called_with(network.device)
        assert (found and found.type) == expected
    assert forecast_on_faster_device("gpu", Mock(), scenarios, seeds) is None


def test_without_a_gpu_nothing_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hardware, "_seconds", None)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert faster_device("auto", model("full_vae"), lambda _: None) == CPU


def test_a_measurement_leaves_model_and_random_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hardware, "TRIAL_SECONDS", 0.0)
    network = model("full_vae")
    before = {name: value.clone() for name, value in network.state_dict().items()}
    state, runs = torch.get_rng_state(), []

    def run(trained: Model) -> None:
        with torch.no_grad():
            next(trained.parameters()).add_(torch.randn(()))
        runs.append(trained)

    assert hardware._seconds(network, CPU, run) > 0
    assert len(runs) == hardware.WARM_UPS + 1
    assert torch.equal(torch.get_rng_state(), state)
    assert network not in runs
    for name, value in network.state_dict().items():
        assert torch.equal(value, before[name])


def test_batches_are_made_where_the_data_lie() -> None:
    tensors = {"states": torch.zeros(5, 3, 2), "actions": torch.zeros(5, 2, 1)}
    data = InMemory(tensors)
    assert data.size() == 4 * (5 * 3 * 2 + 5 * 2)
    batch = data.to(META)[torch.tensor([[0, 2], [1, 4]])]
    assert {name: (v.device, tuple(v.shape)) for name, v in batch.items()} == {
        "states": (META, (2, 2, 3, 2)),
        "actions": (META, (2, 2, 2, 1)),
    }


@pytest.mark.parametrize(
    ("setting", "flags", "size", "expected"),
    [
        ("32", "amx_bf16", 256, "32"),
        ("bf16", "", 8, "bf16"),
        ("auto", "avx512f amx_bf16 amx_tile", 256, "bf16"),
        ("auto", "avx512f amx_bf16 amx_tile", 128, "32"),
        ("auto", "avx512f avx512_bf16", 256, "bf16"),
        ("auto", "avx512f avx512_vnni", 256, "32"),
        ("auto", None, 256, "32"),
    ],
)
def test_precision(
    setting: str, flags: str | None, size: int, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_text(*_: Any, **__: Any) -> str:
        if flags is None:
            raise FileNotFoundError
        return f"flags\t: {flags}\n"

    monkeypatch.setattr(Path, "read_text", read_text)
    network = torch.nn.Sequential(torch.nn.Linear(7, size), torch.nn.Linear(size, size))
    assert width(network) == size
    assert fit_precision(setting, network, CPU) == expected
