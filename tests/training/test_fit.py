"""What a fit logs, its precision, and its end by Ctrl-C."""

import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from study.common.progress import Progress
from study.data.trajectories import ScenarioSet
from study.models.base import LOG_EVERY
from study.models.runtime import forget_uses, uses
from study.training.data_module import TrajectoryDataModule
from study.training.fit import FitOptions, fit
from study.training.inputs import validation_trajectories
from study.training.validation import LogForecastScore, LogNegativeElbo
from tests.helpers.models import model, normalization, trajectories


def test_curves_have_a_point_every_few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    network, points = model("full_vae"), []
    for step in range(3 * LOG_EVERY):
        monkeypatch.setattr(type(network), "global_step", step)
        monkeypatch.setattr(network, "log_dict", lambda values, at=step: points.append(at))
        network.log_curves({"loss": torch.tensor(1.0)})
    # Lightning writes at these steps: see `log_every_n_steps`.
    assert points == [LOG_EVERY - 1, 2 * LOG_EVERY - 1, 3 * LOG_EVERY - 1]


def data_module(data_streams: int | None = None) -> TrajectoryDataModule:
    """Batches of random trajectories."""
    data, observed = trajectories(), trajectories(6, seed=3)
    scenarios = ScenarioSet(
        observed.states[:, 0],
        observed.actions,
        np.zeros((6, 1), np.float32),
        observed.states[:, None, 1:],
        np.zeros((6, 1, 0), np.float32),
        {},
    )
    return TrajectoryDataModule(normalization(), data, scenarios, 4, 0, data_streams)


def test_the_search_may_score_by_the_elbo(tmp_path: Path) -> None:
    data, network = data_module(), model("full_vae")
    options = FitOptions(0, 3, 3, None, accelerator="cpu")
    batch = validation_trajectories(network, data)
    score = fit(network, data, tmp_path, Progress(), options, [LogNegativeElbo(batch)])
    expected = network.negative_elbo(batch)
    assert score == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("precision", ["32", "bf16"])
def test_a_fit_in_a_precision(precision: str, tmp_path: Path) -> None:
    """With a fused optimiser and clipping, which Lightning's own plugin refuses."""
    batches = data_module()
    network: Any = model("probabilistic_mlp")
    before = [value.clone() for value in network.parameters()]
    dtypes: list[torch.dtype] = []
    network.network.stem.register_forward_hook(lambda *call: dtypes.append(call[2].dtype))
    network.network.skip.register_forward_hook(lambda *call: dtypes.append(call[2].dtype))
    score = LogForecastScore(lambda *_: 1.0)  # type: ignore[arg-type]
    options = FitOptions(0, 3, 3, None, accelerator="cpu", precision=precision)
    forget_uses()
    fit(network, batches, tmp_path, Progress(), options, [score])
    # Sums are in float32 in any case.
    assert set(dtypes) == {torch.float32} | ({torch.bfloat16} if precision == "bf16" else set())
    assert uses() == ("cpu" if precision == "32" else "cpu bf16")
    after = list(network.parameters())
    assert any(not torch.equal(*pair) for pair in zip(before, after, strict=True))
    assert all(value.dtype == torch.float32 and value.isfinite().all() for value in after)


def test_validation_is_in_float32(tmp_path: Path) -> None:
    """The ensemble's validation score decides which weights it keeps."""
    network: Any = model("ensemble")
    modes: list[tuple[bool, bool]] = []
    network.members.initial_hidden.register_forward_hook(
        lambda *_: modes.append((network.training, torch.is_autocast_enabled("cpu")))
    )
    options = FitOptions(0, 2, 2, 1, clip=None, accelerator="cpu", precision="bf16")
    fit(network, data_module(network.data_streams), tmp_path, Progress(), options)
    assert set(modes) == {(True, True), (False, False)}


def test_ctrl_c_interrupts_a_fit(tmp_path: Path) -> None:
    """Lightning alone would end the process with exit code 1, and ignore the next Ctrl-C."""

    def interrupt(*_: object) -> float:
        raise KeyboardInterrupt

    handler = signal.getsignal(signal.SIGINT)
    score = LogForecastScore(interrupt)  # type: ignore[arg-type]
    options = FitOptions(0, 2, 2, None, accelerator="cpu")
    with pytest.raises(KeyboardInterrupt):
        fit(model("probabilistic_mlp"), data_module(), tmp_path, Progress(), options, [score])
    assert signal.getsignal(signal.SIGINT) is handler
