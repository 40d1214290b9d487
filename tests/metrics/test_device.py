"""Scores on a device, played on the CPU: the same results as those of numpy."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from study.common.arrays import Array
from study.metrics import device, joint_mmd, kernel_sums
from study.metrics.device import score_device, scores_on
from study.metrics.mmd import bandwidths, mmd, pooled, sensitivity
from study.metrics.proper_scores import energy_score

CPU = torch.device("cpu")
TOLERANCE = 1e-6
SCENARIOS, SAMPLES, ROLLOUTS, STEPS, SIZE = 3, 30, 20, 25, 4


def data(case: str) -> tuple[Array, Array, Array]:
    """Forecasts, observed rollouts and scales."""
    generator = np.random.default_rng(0)
    shapes = [(SCENARIOS, count, STEPS, SIZE) for count in (SAMPLES, ROLLOUTS)]
    forecast, observed = (
        (generator.normal(size=shape) * [1.0, 0.1, 7.0, 1.0]).cumsum(2).astype(np.float32)
        for shape in shapes
    )
    if case == "far":  # for the series, and for products
        forecast[0, 0] += 1e5
    if case == "equal":
        forecast[:], observed[:] = 2.0, 2.0
    if case == "not finite":
        forecast[1, :3, 5:, 1] = [[np.nan], [np.inf], [-np.inf]]
    scale = observed.std((0, 1, 2))
    return forecast, observed, np.where(scale > 0, scale, 1.0)


def scores(forecast: Array, observed: Array, scale: Array) -> dict[str, Any]:
    kernel = (scale, bandwidths(observed, scale))
    return {
        "mmd": mmd(forecast, observed, *kernel).squared,
        "sensitivity": [part.squared for part in sensitivity(forecast, observed, *kernel)],
        "pooled": pooled(forecast, observed, *kernel).squared,
        "joint": joint_mmd.joint_mmd(forecast, observed, *kernel).squared,
        "energy": energy_score(forecast, observed, scale),
    }


@pytest.mark.parametrize("numbers", [device.AT_ONCE, 2000])
@pytest.mark.parametrize("case", ["near", "far", "equal", "not finite"])
def test_the_results_are_those_of_numpy(
    case: str, numbers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In one block, and in many."""
    monkeypatch.setattr(device, "AT_ONCE", numbers)
    arguments = data(case)
    expected = scores(*arguments)
    with scores_on(CPU):
        found = scores(*arguments)
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, rtol=TOLERANCE, atol=TOLERANCE)
    if case == "equal":
        assert not np.any(found["mmd"])


@pytest.mark.parametrize(
    ("module", "function", "run"),
    [
        (kernel_sums, "_mean_powers_on", mmd),
        (joint_mmd, "_mean_gap_on", joint_mmd.joint_mmd),
    ],
)
def test_the_device_is_that_of_the_block(
    module: Any, function: str, run: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    used: list[torch.device] = []
    original = getattr(module, function)

    def counted(where: torch.device, *arguments: Any) -> Any:
        used.append(where)
        return original(where, *arguments)

    monkeypatch.setattr(module, function, counted)
    forecast, observed, scale = data("near")
    arguments = (forecast, observed, scale, bandwidths(observed, scale))
    run(*arguments)
    assert (used, score_device()) == ([], None)
    with scores_on(CPU):
        run(*arguments)
    assert set(used) == {CPU}
    assert score_device() is None


def test_the_distances_of_the_energy_score_are_on_the_device() -> None:
    """The device `meta` has no numbers to return."""
    with scores_on(torch.device("meta")), pytest.raises(NotImplementedError, match="meta"):
        energy_score(*data("near"))
