"""A GPU against one CPU core, and bfloat16 against float32: ``python -m tests.benchmarks.gpu``.

All at the sizes of ``configs/paper.yaml``, on the Pusher:

- *training*: one optimiser step of each model, at batch 12 and 512. The ensemble and the full CRPS
  model have two kinds of steps;
- *forecast*: 1,000 samples of one scenario over 120 steps, with and without the random numbers;
- *bfloat16*: a training step on the CPU in both precisions, at widths of 128 and 256;
- *scores*: of 10 scenarios with 100 forecasts and 100 observed rollouts each;
- *parity*: loss, gradient, forecasts and scores on both devices, with the same random numbers.

Without a GPU the script measures the CPU, and says what it did not run. ``--parts parity training``
runs only some of it.
"""

import argparse
import copy
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from typing import Any
from unittest import mock

import numpy as np
import torch
from torch import Tensor

from study.common.arrays import Array
from study.common.seeds import spawn
from study.config.model_sections import Mlp, Vae
from study.config.settings import Config
from study.data.trajectories import Trajectories
from study.metrics.device import scores_on
from study.metrics.joint_mmd import joint_mmd
from study.metrics.mmd import bandwidths, mmd
from study.metrics.proper_scores import energy_score
from study.models import Model
from study.models.rnn_ensemble import RnnEnsemble
from study.models.sampling import sample_noise
from study.training.hardware import has_bfloat16_units
from tests.benchmarks.report import processor, save
from tests.benchmarks.sizes import SIZES, build_model, observe
from tests.benchmarks.timing import as_a_worker

MODELS = ("ensemble", "residual_vae", "full_vae", "probabilistic_mlp", "full_crps")
BATCHES, WIDTHS = (12, 512), (128, 256)
SAMPLES = 1000
LAST = 10**6
"""A step after the last one."""
STEPS = {
    "ensemble": {"true states": 0, "rollouts": LAST},
    "full_crps": {"transitions": 0, "rollouts": LAST},
}
"""Optimiser steps that differ, by model."""
TOLERANCE = 1e-4
"""Largest difference between the devices, relative to the largest number, or to 1."""
CPU = torch.device("cpu")
SCORE_TOLERANCE = 1e-6
PARTS = ("parity", "training", "forecast", "scores", "bfloat16")
Row = dict[str, Any]


def paper(name: str, data: Trajectories, config: Config = SIZES["paper"]) -> Any:
    """A model of the paper's size with initial weights; VAEs are teacher forced."""
    model = build_model(name, config, data)
    if hasattr(model.settings, "vae"):
        forced = replace(model.settings.vae, teacher_forcing="always")
        model.settings = replace(model.settings, vae=forced)
    if isinstance(model, RnnEnsemble):
        half = replace(model.settings.ensemble, teacher_forcing_fraction=0.5)
        model.settings = replace(model.settings, ensemble=half)
    return model


def batch_of(model: Model, data: Trajectories, size: int) -> dict[str, Tensor]:
    """A training batch on the model's device."""
    states, actions = (torch.from_numpy(v[:size]) for v in (data.states, data.actions))
    batch = {"states": model.normalize_states(states)}
    batch["actions"] = (actions.to(model.device) - model.action_mean) / model.action_scale
    if model.data_streams:
        return {name: torch.stack([values] * model.data_streams) for name, values in batch.items()}
    if model.uses_ensemble:
        with torch.no_grad():
            ensemble: Any = model.ensemble
            batch["members"] = ensemble(batch["states"][:, 0], batch["actions"])
    return batch


def training_step(
    model: Model, batch: dict[str, Tensor], step: int, bfloat16: bool = False
) -> Callable[[], object]:
    """Loss, gradient and AdamW. With a rate of 0 every repeat has the same numbers."""
    parameters = [value for value in model.parameters() if value.requires_grad]
    optimizer = torch.optim.AdamW(parameters, lr=0.0, weight_decay=0.0, fused=True)

    def run() -> None:
        optimizer.zero_grad()
        with torch.autocast(model.device.type, torch.bfloat16, bfloat16, cache_enabled=False):
            loss = model.losses(batch, step)["loss"]
        loss.backward()
        optimizer.step()

    return run


def milliseconds(run: Callable[[], object], device: torch.device, repeats: int) -> float:
    """The median of the repeats: processor time on the CPU, wall time on a GPU."""
    clock = time.thread_time if device == CPU else time.perf_counter
    times = []
    for repeat in range(-3 if device.type == "cuda" else -1, repeats):
        start = clock()
        run()
        if device.type == "cuda":
            torch.cuda.synchronize()
        if repeat >= 0:
            times.append(clock() - start)
    return 1e3 * float(np.median(times))


def measure(devices: list[torch.device], runs: Callable[[torch.device], Any], repeats: int) -> Row:
    """Milliseconds on each device, and the ratio of the first to the last."""
    times = {device.type: milliseconds(runs(device), device, repeats) for device in devices}
    ratio = times["cpu"] / times["cuda"] if "cuda" in times else None
    return {"cpu": times["cpu"], "gpu": times.get("cuda"), "ratio": ratio}


def trainings(devices: list[torch.device], data: Trajectories, repeats: int) -> Iterator[Row]:
    """One step of each model, batch and kind of step."""
    for name in MODELS:
        models = {device: copy.deepcopy(paper(name, data)).to(device) for device in devices}
        for size in BATCHES:
            for kind, step in STEPS.get(name, {"all": 0}).items():
                few = repeats if size == BATCHES[0] else max(1, repeats // 5)

                def runs(device: torch.device, size: int = size, step: int = step) -> Any:
                    model = models[device]  # noqa: B023 - called at once
                    return training_step(model, batch_of(model, data, size), step)

                yield {"what": f"{name}, {kind}, batch {size}"} | measure(devices, runs, few)


def forecasts(devices: list[torch.device], data: Trajectories, repeats: int) -> Iterator[Row]:
    """Forecasts of one scenario."""
    s0, actions, seeds = data.states[:1, 0], data.actions[:1], spawn(0, 1)
    for name in MODELS:
        models = {device: paper(name, data).to(device) for device in devices}

        def whole(device: torch.device) -> Any:
            return lambda: models[device].forecast(s0, actions, SAMPLES, seeds)  # noqa: B023

        def network(device: torch.device) -> Any:
            model = models[device]  # noqa: B023
            inputs = model.normalize(torch.from_numpy(s0), torch.from_numpy(actions))
            noise = torch.from_numpy(
                sample_noise(seeds, SAMPLES, actions.shape[1], model.noise_size)
            )
            noise = noise.to(device)
            member = torch.zeros(1, SAMPLES, dtype=torch.int64, device=device)
            return torch.no_grad()(lambda: model.sample(*inputs, noise, member))

        yield {"what": f"{name}"} | measure(devices, whole, repeats)
        yield {"what": f"{name}, network alone"} | measure(devices, network, repeats)


def precisions(data: Trajectories, repeats: int) -> Iterator[Row]:
    """Float32 and bfloat16 on the CPU."""
    for name in ("probabilistic_mlp", "full_vae"):
        for width in WIDTHS:
            config = replace(
                SIZES["paper"],
                sections={"vae": Vae(hidden_size=width), "mlp": Mlp(hidden_size=width)},
            )
            model = paper(name, data, config)
            for size in (12, 64):
                batch = batch_of(model, data, size)
                exact, rounded = (
                    milliseconds(training_step(model, batch, 0, bfloat16), CPU, repeats)
                    for bfloat16 in (False, True)
                )
                what = f"{name}, width {width}, batch {size}"
                yield {"what": what, "32": exact, "bf16": rounded, "ratio": exact / rounded}


@contextmanager
def same_noise() -> Iterator[None]:
    """Random numbers of training come from the CPU on every device."""
    like, normal, integers, rows = torch.randn_like, torch.randn, torch.randint, torch.multinomial

    def randn_like(values: Tensor) -> Tensor:
        return like(values, device=CPU).to(values.device)

    def randn(*size: int, device: torch.device) -> Tensor:
        return normal(*size).to(device)

    def randint(high: int, size: Any, device: torch.device) -> Tensor:
        return integers(high, size).to(device)

    def multinomial(probabilities: Tensor, count: int, replacement: bool) -> Tensor:
        return rows(probabilities.cpu(), count, replacement).to(probabilities.device)

    fakes: dict[str, Any] = {
        fake.__name__: fake for fake in (randn_like, randn, randint, multinomial)
    }
    with mock.patch.multiple(torch, **fakes):
        yield


def parity(devices: list[torch.device], data: Trajectories) -> Iterator[Row]:
    """Differences between the devices: of the loss, of its gradient, and of forecasts."""
    seeds, few = spawn(0, 8), slice(0, 8)
    for name in MODELS:
        results = []
        for device in devices:
            model = paper(name, data).to(device)
            batch, numbers = batch_of(model, data, 12), []
            for step in STEPS.get(name, {"all": 0}).values():
                for _ in range(3):  # the last times as a CUDA graph
                    model.zero_grad()
                    torch.manual_seed(0)
                    with same_noise():
                        loss = model.losses(batch, step)["loss"]
                    loss.backward()
                gradients = [p.grad.flatten() for p in model.parameters() if p.grad is not None]
                numbers.append(torch.cat([loss.detach().flatten(), *gradients]).cpu())
            for _ in range(3):
                forecast = model.forecast(data.states[few, 0], data.actions[few], 20, seeds)
            states = model.normalize_states(torch.from_numpy(forecast)).cpu()
            results.append((*numbers, states))
        kinds = [*(f"training, {kind}" for kind in STEPS.get(name, {"all": 0})), "forecast"]
        for kind, ours, theirs in zip(kinds, *results, strict=True):
            largest = max(1.0, float(ours.abs().max()))
            difference = float((ours - theirs).abs().max()) / largest
            yield {
                "what": f"{name}, {kind}",
                "difference": difference,
                "ok": difference < TOLERANCE,
            }


def score_functions() -> dict[str, Callable[[], Array]]:
    """The scores of random walks, with the sizes of ``configs/paper.yaml`` for ten scenarios."""
    generator = np.random.default_rng(0)
    forecast, observed = (
        generator.normal(size=(10, 100, 120, 8)).cumsum(2).astype(np.float32) for _ in range(2)
    )
    scale = observed.std((0, 1, 2))
    arguments = (forecast, observed, scale, bandwidths(observed, scale))
    return {
        "MMD²": lambda: mmd(*arguments).squared,
        "joint MMD²": lambda: joint_mmd(*arguments).squared,
        "energy score": lambda: energy_score(forecast, observed, scale),
    }


def on_device(device: torch.device, function: Callable[[], Array]) -> Array:
    """The scores by numpy, or on a GPU."""
    with scores_on(None if device == CPU else device):
        return function()


def scores(devices: list[torch.device], repeats: int) -> Iterator[Row]:
    """Milliseconds of each score."""
    for name, function in score_functions().items():

        def runs(device: torch.device, function: Callable[[], Array] = function) -> Any:
            return lambda: on_device(device, function)

        yield {"what": name} | measure(devices, runs, repeats)


def score_parity(devices: list[torch.device]) -> Iterator[Row]:
    """Differences of the scores."""
    for name, function in score_functions().items():
        ours, theirs = (on_device(device, function) for device in devices)
        difference = float(np.abs(ours - theirs).max())
        yield {"what": name, "difference": difference, "ok": difference < SCORE_TOLERANCE}


def show(title: str, rows: Iterator[Row]) -> list[Row]:
    """Print rows as they come. Times are in milliseconds."""
    print(f"== {title}", flush=True)
    shown = []
    for row in rows:
        values = [
            f"{key} {value:.3g}" if isinstance(value, float) else f"{key} {value}"
            for key, value in row.items()
            if key != "what" and value is not None
        ]
        print(f"{row['what']:45} {', '.join(values)}", flush=True)
        shown.append({"part": title} | row)
    return shown


def main() -> int:
    """Measure, print and save; 1 if the devices differ."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    arguments = parser.parse_args()
    repeats = arguments.repeats
    as_a_worker()
    torch.use_deterministic_algorithms(True, warn_only=True)  # as in a study
    has_gpu = torch.cuda.is_available()
    devices = [CPU, *([torch.device("cuda", 0)] if has_gpu else [])]
    gpu = torch.cuda.get_device_name() if has_gpu else "no GPU"
    print(f"{processor()}, bfloat16 units: {has_bfloat16_units(CPU)}; {gpu}")
    data = observe("pusher", max(BATCHES))
    parts = {
        "parity": chain(parity(devices, data), score_parity(devices)),
        "training": trainings(devices, data, repeats),
        "forecast": forecasts(devices, data, repeats),
        "scores": scores(devices, max(1, repeats // 5)),
        "bfloat16": precisions(data, repeats),
    }
    wanted = [part for part in arguments.parts if has_gpu or part != "parity"]
    rows = [row for part in wanted for row in show(part, parts[part])]
    if not has_gpu:
        print("not run, since torch finds no GPU here: parity, and every column of the GPU")
    save("gpu", rows)
    return int(not all(row.get("ok", True) for row in rows))


if __name__ == "__main__":
    raise SystemExit(main())
