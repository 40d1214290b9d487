"""What more work costs: ``python -m tests.benchmarks.scale --to tests/benchmarks/scale.png``.

Seconds of one processor, and peak memory beyond what the program itself takes, while one size grows
and the others stay as in ``configs/quick.yaml``: trajectories collected, horizon, width of the
networks, members of the ensemble, samples of a forecast, workers. Each point is a process of its
own, since a process's peak never falls. Prints a table, and draws it; a line's slope is the
exponent p of cost ~ size^p.

Collecting without physics is the stage as it is, with constant numbers in place of what MuJoCo
would give: it says what memory a set takes that would take long to simulate, and what the stage
does besides.
"""

import argparse
import multiprocessing
import resource
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from study.config import Config
from study.envs import Rollout
from study.envs.pusher import Pusher
from study.progress import Progress
from study.seeds import spawn
from study.stages import collect
from tests.benchmarks.sizes import built, observe
from tests.benchmarks.timing import as_a_worker
from tests.benchmarks.training import BATCH, batch_for, step_of

SCENARIOS = 16
"""Whose forecasts are timed."""
STEPS = 3
"""Of training, the first not counted."""


@dataclass(frozen=True)
class Cost:
    """Of one point: seconds of the processor, seconds on the clock, and bytes at the peak."""

    processor: float
    clock: float
    memory: float


def cost_of(work: Callable[[], object]) -> Cost:
    """Do it once."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    clock, processor = time.perf_counter(), time.process_time()
    work()
    processor, clock = time.process_time() - processor, time.perf_counter() - clock
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return Cost(processor, clock, 1024.0 * (after - before))


def collection(count: int, physics: bool) -> Cost:
    """Stage collect, with two scenarios each to validate and to test on."""
    sizes = {"trajectories": count, "validation": 2, "scenarios": 2, "rollouts": 2}
    settings = {"environment": "pusher", "collect": sizes | {"horizon": None, "seed": 0}}

    def constant_plan(self: Pusher, scenarios: Any, seeds: Any) -> Any:
        return np.full((len(seeds), self.horizon, len(self.action)), 0.5, np.float32)

    def constant_rollout(self: Pusher, s0: Any, actions: Any, seeds: Any = None) -> Rollout:
        shape = (len(s0), self.horizon + 1, len(self.state))
        states = np.full(shape, 0.5, np.float32) + s0[:, None]
        return Rollout(states, np.zeros((len(s0), len(self.hidden)), np.float32))

    def work() -> None:
        with tempfile.TemporaryDirectory() as folder:
            collect.run(settings, {}, Path(folder), Progress())

    if physics:
        return cost_of(work)
    with mock.patch.multiple(Pusher, plan=constant_plan, rollout=constant_rollout):
        return cost_of(work)


def training(name: str, config: Config, horizon: int | None = None) -> Cost:
    """One step on one batch."""
    data = observe("pusher", BATCH, horizon)
    model = built(name, config, data)
    step = step_of(model, batch_for(name, config, model, data))
    costs = [cost_of(step) for _ in range(STEPS)]
    return Cost(
        float(np.median([cost.processor for cost in costs[1:]])),
        float(np.median([cost.clock for cost in costs[1:]])),
        max(cost.memory for cost in costs),
    )


def forecasting(name: str, config: Config, samples: int, horizon: int | None = None) -> Cost:
    """Forecasts of `SCENARIOS` scenarios."""
    data = observe("pusher", SCENARIOS, horizon)
    model = built(name, config, data).eval()
    s0, actions, seeds = data.states[:, 0], data.actions, spawn(0, len(data))
    model.forecast(s0[:1], actions[:1], 2, seeds[:1])
    return cost_of(lambda: model.forecast(s0, actions, samples, seeds))


Given = Callable[[int], tuple[Any, ...]]


@dataclass(frozen=True)
class Line:
    """A cost as one size grows: `measure` takes it."""

    panel: str
    label: str
    sizes: tuple[int, ...]
    measure: Callable[..., Cost]
    given: Given


def lines() -> Iterator[Line]:
    """What is measured."""
    base, samples = Config(), 40

    def wide(size: int) -> Config:
        return replace(
            base,
            vae=replace(base.vae, hidden_size=size),
            mlp=replace(base.mlp, hidden_size=size),
            ensemble=replace(base.ensemble, hidden_size=size),
        )

    def of_members(size: int) -> Config:
        return replace(base, ensemble=replace(base.ensemble, members=size))

    # Arguments of `training` and of `forecasting`, by what grows.
    def steps_of(name: str) -> tuple[Given, Given]:
        return lambda n: (name, base, n), lambda n: (name, wide(n))

    def forecasts_of(name: str) -> tuple[Given, Given]:
        return lambda n: (name, base, samples, n), lambda n: (name, wide(n), samples)

    yield Line("trajectories", "collect", (500, 1000, 2000), collection, lambda n: (n, True))
    far = (1000, 3000, 10_000, 30_000, 100_000)
    yield Line("trajectories", "collect, no physics", far, collection, lambda n: (n, False))
    long, width = (30, 60, 120, 240, 480), (32, 64, 128, 256)
    for name in ("full_vae", "probabilistic_mlp"):
        longer, wider = steps_of(name)
        yield Line("horizon", f"{name}, step", long, training, longer)
        yield Line("hidden size", f"{name}, step", width, training, wider)
        longer, wider = forecasts_of(name)
        yield Line("horizon", f"{name}, forecast", long, forecasting, longer)
        yield Line("hidden size", f"{name}, forecast", width, forecasting, wider)
    few = (1, 2, 5, 10)
    yield Line("members", "ensemble, step", few, training, lambda n: ("ensemble", of_members(n)))
    name = "residual_vae"
    label = "residual_vae, forecast"
    yield Line("members", label, few, forecasting, lambda n: (name, of_members(n), samples))
    many = (10, 30, 100, 300, 1000, 2000)
    yield Line("samples", label, many, forecasting, lambda n: (name, base, n))


def measured(line: Line, executor: Callable[[], ProcessPoolExecutor]) -> list[Cost]:
    """Each point in a process of its own."""
    costs = []
    for size in line.sizes:
        with executor() as pool:
            future: Future[Cost] = pool.submit(line.measure, *line.given(size))
            costs.append(future.result())
    return costs


def side_by_side(workers: int, executor: Callable[..., ProcessPoolExecutor]) -> float:
    """Seconds on the clock for four times the same forecasts."""
    with executor(workers) as pool:
        for warm in [pool.submit(int) for _ in range(workers)]:
            warm.result()
        start = time.perf_counter()
        tasks = [pool.submit(forecasting, "full_vae", Config(), 300) for _ in range(4)]
        for task in tasks:
            task.result()
        return time.perf_counter() - start


def slope(sizes: tuple[int, ...], values: list[float]) -> float:
    """Exponent p of value ~ size^p, over the upper half of the sizes."""
    upper = slice(len(sizes) // 2, None) if len(sizes) > 2 else slice(None)
    if len(sizes[upper]) < 2:
        upper = slice(-2, None)
    return float(np.polyfit(np.log(sizes[upper]), np.log(values[upper]), 1)[0])


def draw(results: list[tuple[Line, list[Cost]]], workers: dict[int, float], to: Path) -> None:
    """One figure: seconds above, memory below."""
    panels = list(dict.fromkeys(line.panel for line, _ in results))
    figure = Figure(figsize=(3.0 * (len(panels) + 1), 5.2), layout="constrained")
    axes = figure.subplots(2, len(panels) + 1)
    for column, panel in enumerate(panels):
        seconds, memory = axes[:, column]
        for line, costs in results:
            if line.panel == panel:
                label = line.label.replace("_", " ")
                seconds.plot(line.sizes, [c.processor for c in costs], "o-", ms=3, label=label)
                memory.plot(line.sizes, [c.memory / 1e6 for c in costs], "o-", ms=3)
        seconds.legend(fontsize=6, frameon=False)
        for axis in (seconds, memory):
            _logarithmic(axis, panel)
    _logarithmic(axes[0, -1], "workers")
    axes[0, -1].plot(list(workers), list(workers.values()), "o-", ms=3)
    axes[0, -1].set_xticks(list(workers), [str(n) for n in workers], minor=False)
    axes[0, -1].set_title("seconds by the clock", fontsize=7)
    axes[1, -1].axis("off")
    axes[0, 0].set_ylabel("processor seconds")
    axes[1, 0].set_ylabel("peak memory, MB")
    figure.savefig(to, dpi=90)


def _logarithmic(axis: Axes, label: str) -> None:
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlabel(label, fontsize=8)
    axis.tick_params(labelsize=7)
    axis.grid(alpha=0.3, which="both", lw=0.4)


def main() -> None:
    """Print the table, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--to", type=Path, help="file of the figure; none is drawn if not given")
    given = parser.parse_args()
    as_a_worker()
    # Processes are forked from one that has everything imported, and has done nothing else.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.benchmarks.scale"])

    def executor(workers: int = 1) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(workers, mp_context=context)

    results = []
    for line in lines():
        costs = measured(line, executor)
        results.append((line, costs))
        seconds, memory = [c.processor for c in costs], [max(c.memory, 1.0) for c in costs]
        print(f"{line.panel}: {line.label}")
        for size, cost in zip(line.sizes, costs, strict=True):
            print(f"  {size:8,} {cost.processor:9.3f} s {cost.memory / 1e6:9.1f} MB")
        print(f"  seconds ~ size^{slope(line.sizes, seconds):.2f}", end="")
        print(f", memory ~ size^{slope(line.sizes, memory):.2f}", flush=True)
    workers = {count: side_by_side(count, executor) for count in (1, 2)}
    print("workers: " + ", ".join(f"{n}: {seconds:.1f} s" for n, seconds in workers.items()))
    if given.to:
        draw(results, workers, given.to)


if __name__ == "__main__":
    main()
