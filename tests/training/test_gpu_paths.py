"""A whole fit on the paths of a GPU, played on the CPU: the same weights and forecasts."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from study.common.arrays import Floats
from study.common.progress import Progress
from study.common.seeds import spawn
from study.models.unroll import graphs, gru, kernel
from study.training.fit import FitOptions, fit
from study.training.validation import LogForecastScore
from tests.helpers.models import OURS, model, trajectories
from tests.models.unroll.test_graphs import FakeCapture
from tests.training.test_device_trials import data_of

SAMPLES, STEPS = 2, 6


def score(network: Any, batch: dict[str, Tensor]) -> float:
    """A validation score."""
    s0, actions = (batch[name].numpy() for name in ("s0", "actions"))
    return float(np.abs(network.forecast(s0, actions, SAMPLES, spawn(0, len(s0)))).mean())


def results(name: str, folder: Path) -> tuple[list[Tensor], list[Floats]]:
    """The weights of a fit, and forecasts with them.

    The optimal σ makes up for the bias of w. So the gradient of that bias is rounding error, which
    AdamW scales up. The bias is left out, and has a small effect on the forecasts.
    """
    network, observed = model(name), trajectories(6, seed=3)
    options = FitOptions(0, STEPS, 2, None, accelerator="cpu")
    callbacks = [] if name == "ensemble" else [LogForecastScore(score)]  # type: ignore[arg-type]
    fit(network, data_of(network), folder, Progress(), options, callbacks)
    forecasts = [
        network.forecast(observed.states[:, 0], observed.actions, SAMPLES, spawn(0, 6))
        for _ in range(3)
    ]
    weights = network.state_dict()
    compared = [value for key, value in weights.items() if not key.endswith("log_std.bias")]
    return compared, forecasts


@pytest.mark.parametrize("name", ["ensemble", *OURS])
def test_a_fit(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel, "library", lambda: None)
    expected, expected_forecasts = results(name, tmp_path / "loop")
    fake = FakeCapture()
    monkeypatch.setattr(graphs, "are_used", lambda device: True)
    monkeypatch.setattr(graphs, "cuda_capture", fake)
    monkeypatch.setattr(gru, "library_is_used", lambda device: True)
    found, forecasts = results(name, tmp_path / "gpu")
    assert fake.captures > 0
    assert fake.replays > 2
    torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(forecasts, expected_forecasts, rtol=1e-3, atol=2e-3)
