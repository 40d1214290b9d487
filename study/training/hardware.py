"""The device and the precision of a fit or of a forecast.

Which device is faster depends on the model, its sizes, the batch and the machine. So `auto`
measures: each device runs the same work for half a second. Without a GPU nothing is measured.
"""

import copy
import logging
import math
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import torch
from torch import nn

from study.common.errors import StudyError
from study.common.seeds import Seeds
from study.data.trajectories import ScenarioSet
from study.models.base import Forecaster, Model
from study.models.runtime import report_use
from study.training.data_module import TrajectoryDataModule

CPU = torch.device("cpu")
TRIAL_SECONDS = 0.5
"""Seconds of measurement on each device, after `WARM_UPS` runs."""
WARM_UPS = 3
"""Runs before the measurement. A CUDA graph is captured at the second one."""
WIDE = 256
"""Smallest width of a layer for which `auto` takes bfloat16: see `tests/benchmarks/README.md`."""
TRIAL_SAMPLES = 40
"""Forecasts of each scenario in a measurement."""

Run = Callable[[Model], object]

_log = logging.getLogger(__name__)


def gpu(accelerator: str) -> torch.device | None:
    """The GPU that a stage may use; None for none.

    Args:
        accelerator: see `Train`. `auto` ignores Apple's GPUs, since they have no CUDA graphs.

    Raises:
        StudyError: the accelerator is `gpu`, and there is none.
    """
    if accelerator == "cpu":
        return None
    if torch.cuda.is_available():
        return torch.device("cuda", torch.cuda.current_device())
    if accelerator != "gpu":
        return None
    if torch.backends.mps.is_available():
        return torch.device("mps")
    raise StudyError("train.accelerator: got 'gpu', and torch finds none here; give auto or cpu")


def fit_device(
    accelerator: str, model: Model, data: TrajectoryDataModule, steps: int
) -> torch.device:
    """The device of a fit. A loss may change during training, so three of its steps are measured.

    Args:
        accelerator: see `Train`.
        model: a new model, which stays as it is.
        data: its batches.
        steps: number of optimiser steps.

    Raises:
        StudyError: the accelerator is `gpu`, and there is none.
    """
    has_losses = type(model).losses is not Model.losses

    def run(trained: Model) -> None:
        batch = {name: values.to(trained.device) for name, values in data.first_batch().items()}
        for step in (0, steps // 2, steps - 1):
            loss = (
                trained.losses(batch, step)["loss"] if has_losses else trained.training_step(batch)
            )
            loss.backward()

    return faster_device(accelerator, model, run)


def forecast_on_faster_device(
    accelerator: str, forecaster: Forecaster, test: ScenarioSet, seeds: Seeds
) -> torch.device | None:
    """Move a model to the device on which it forecasts faster.

    Args:
        accelerator: see `Train`.
        forecaster: anything but a model stays on the CPU.
        test: scenarios, of which some are forecast.
        seeds: of the scenarios, [S].

    Returns:
        the device for `study.metrics.device.scores_on`: a GPU that has float64; None without.

    Raises:
        StudyError: the accelerator is `gpu`, and there is none.
    """
    if not isinstance(forecaster, Model):
        return None
    few = slice(0, 5)

    def run(model: Model) -> None:
        model.forecast(test.s0[few], test.actions[few], TRIAL_SAMPLES, seeds[few])

    forecaster.to(faster_device(accelerator, forecaster, run))
    report_use(forecaster.device)
    return forecaster.device if forecaster.device.type == "cuda" else None


def faster_device(accelerator: str, model: Model, run: Run) -> torch.device:
    """The device on which `run` takes less time. `cpu` and `gpu` are not measured.

    A device on which `run` fails is not chosen, for example a GPU without free memory.

    Args:
        accelerator: see `Train`.
        model: stays as it is; copies of it run. The random numbers that follow stay the same.
        run: the work that is measured, with a model that is on the device.

    Raises:
        StudyError: the accelerator is `gpu`, and there is none.
    """
    device = gpu(accelerator)
    if device is None or accelerator == "gpu":
        return device or CPU
    seconds = {candidate: _seconds_or_inf(model, candidate, run) for candidate in (CPU, device)}
    chosen = min(seconds, key=lambda candidate: seconds[candidate])
    times = ", ".join(f"{candidate} {1e3 * value:.1f} ms" for candidate, value in seconds.items())
    _log.info("accelerator auto: %s (%s)", chosen, times)
    return chosen


def _seconds_or_inf(model: Model, device: torch.device, run: Run) -> float:
    """See `_seconds`; infinite if `run` fails, which is logged."""
    try:
        return _seconds(model, device, run)
    except Exception as error:
        _log.warning("accelerator auto: not on %s: %s: %s", device, type(error).__name__, error)
        return math.inf


def _seconds(model: Model, device: torch.device, run: Run) -> float:
    """The shortest duration of `run` on a device."""
    with ExitStack() as stack:
        gpus = [] if device.type == "cpu" else [device]
        stack.enter_context(
            torch.random.fork_rng(gpus, device_type=device.type if gpus else "cuda")
        )
        trial = copy.deepcopy(model).to(device)
        durations: list[float] = []
        began = time.perf_counter()
        while len(durations) <= WARM_UPS or time.perf_counter() - began < TRIAL_SECONDS:
            start = time.perf_counter()
            run(trial)
            if gpus:
                torch.get_device_module(device).synchronize()
            durations.append(time.perf_counter() - start)
            if len(durations) == WARM_UPS:
                began = time.perf_counter()
    return min(durations[WARM_UPS:])


def fit_precision(precision: str, model: nn.Module, device: torch.device) -> str:
    """The precision of a fit, `32` or `bf16`.

    Args:
        precision: see `Train`.
        model: the model.
        device: of the fit.
    """
    if precision != "auto":
        return precision
    return "bf16" if width(model) >= WIDE and has_bfloat16_units(device) else "32"


def width(model: nn.Module) -> int:
    """The smaller side of the largest matrix among the parameters; 0 without a matrix."""
    sides = [tuple(value.shape[-2:]) for value in model.parameters() if value.dim() > 1]
    return min(max(sides, key=math.prod)) if sides else 0


def has_bfloat16_units(device: torch.device) -> bool:
    """Whether a device multiplies matrices faster in bfloat16: with AMX or AVX512-BF16, for a CPU.

    See `tests/benchmarks/gpu.py`.
    """
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    try:
        flags = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return False
    return "amx_bf16" in flags or "avx512_bf16" in flags
