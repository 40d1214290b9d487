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
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from study.config.settings import Config
from tests.benchmarks.costs import Cost, collection, forecasting, training
from tests.benchmarks.timing import as_a_worker

SAMPLES = 40


@dataclass(frozen=True)
class Line:
    """A cost as one size grows; `measure` takes the size, and runs in a process of its own."""

    panel: str
    label: str
    sizes: tuple[int, ...]
    measure: Callable[[int], Cost]


def sized(setting: str, size: int) -> tuple[Config, int, int | None]:
    """The quick configuration, samples of a forecast and horizon, one of them another."""
    base, samples, horizon = Config(), SAMPLES, None
    if setting == "hidden size":
        base = replace(
            base,
            vae=replace(base.vae, hidden_size=size),
            mlp=replace(base.mlp, hidden_size=size),
            ensemble=replace(base.ensemble, hidden_size=size),
        )
    elif setting == "members":
        base = replace(base, ensemble=replace(base.ensemble, members=size))
    elif setting == "samples":
        samples = size
    else:
        horizon = size
    return base, samples, horizon


def step(name: str, setting: str, size: int) -> Cost:
    """Of a step of training."""
    config, _, horizon = sized(setting, size)
    return training(name, config, horizon)


def forecast(name: str, setting: str, size: int) -> Cost:
    """Of forecasts of all scenarios."""
    config, samples, horizon = sized(setting, size)
    return forecasting(name, config, samples, horizon)


def lines() -> Iterator[Line]:
    """What is measured."""
    simulated, made_up = partial(collection, physics=True), partial(collection, physics=False)
    yield Line("trajectories", "collect", (500, 1000, 2000), simulated)
    far = (1000, 3000, 10_000, 30_000, 100_000)
    yield Line("trajectories", "collect, no physics", far, made_up)
    growing = {"horizon": (30, 60, 120, 240, 480), "hidden size": (32, 64, 128, 256)}
    for name in ("full_vae", "probabilistic_mlp"):
        for setting, sizes in growing.items():
            yield Line(setting, f"{name}, step", sizes, partial(step, name, setting))
            yield Line(setting, f"{name}, forecast", sizes, partial(forecast, name, setting))
    few, name = (1, 2, 5, 10), "residual_vae"
    yield Line("members", "ensemble, step", few, partial(step, "ensemble", "members"))
    yield Line("members", f"{name}, forecast", few, partial(forecast, name, "members"))
    many = (10, 30, 100, 300, 1000, 2000)
    yield Line("samples", f"{name}, forecast", many, partial(forecast, name, "samples"))


def measured(line: Line, executor: Callable[[], ProcessPoolExecutor]) -> list[Cost]:
    """Each point in a process of its own."""
    costs = []
    for size in line.sizes:
        with executor() as pool:
            future: Future[Cost] = pool.submit(line.measure, size)
            costs.append(future.result())
    return costs


def side_by_side(workers: int, executor: Callable[..., ProcessPoolExecutor]) -> float:
    """Seconds on the clock for four times the same forecasts."""
    with executor(workers) as pool:
        # A process each, begun before the clock starts.
        for begun in [pool.submit(forecast, "full_vae", "samples", 2) for _ in range(workers)]:
            begun.result()
        start = perf_counter()
        for task in [pool.submit(forecast, "full_vae", "samples", 300) for _ in range(4)]:
            task.result()
        return perf_counter() - start


def slope(sizes: tuple[int, ...], values: list[float]) -> float:
    """Exponent p of value ~ size^p, over the upper half of the sizes."""
    upper = slice((len(sizes) - 1) // 2, None)
    return float(np.polyfit(np.log(sizes[upper]), np.log(values[upper]), 1)[0])


def draw(results: list[tuple[Line, list[Cost]]], workers: dict[int, float], to: Path) -> None:
    """One figure: seconds above, memory below."""
    panels = list(dict.fromkeys(line.panel for line, _ in results))
    figure = Figure(figsize=(2.6 * len(panels), 5.0), layout="constrained")
    axes = figure.subplots(2, len(panels))
    for (seconds, memory), panel in zip(axes.T, panels, strict=True):
        shown = [(line, costs) for line, costs in results if line.panel == panel]
        for line, costs in shown:
            label = line.label.replace("_", " ")
            seconds.plot(line.sizes, [c.processor for c in costs], "o-", ms=3, label=label)
            memory.plot(line.sizes, [c.memory / 1e6 for c in costs], "o-", ms=3)
        seconds.legend(fontsize=6, frameon=False)
        for axis in (seconds, memory):
            _logarithmic(axis, panel, sorted({size for line, _ in shown for size in line.sizes}))
    axes[0, 0].set_ylabel("processor seconds", fontsize=8)
    axes[1, 0].set_ylabel("peak memory, MB", fontsize=8)
    told = ", ".join(f"{seconds:.1f} s with {count}" for count, seconds in workers.items())
    figure.suptitle(f"Cost against work, quick size; workers, by the clock: {told}", fontsize=8)
    figure.savefig(to, dpi=90)


def _logarithmic(axis: Axes, label: str, sizes: list[int]) -> None:
    axis.set_xscale("log")
    axis.set_yscale("log")
    told = [f"{size // 1000}k" if size >= 1000 else str(size) for size in sizes]
    axis.set_xticks(sizes, told, fontsize=6)
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.tick_params(labelsize=6, which="both")
    axis.set_xlabel(label, fontsize=8)
    axis.grid(alpha=0.3, lw=0.4)


def main() -> None:
    """Print the table, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--to", type=Path, help="file of the figure; none is drawn if not given")
    given = parser.parse_args()
    as_a_worker()
    # Processes are forked from one that has everything imported, and has done nothing else.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.benchmarks.costs"])

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
