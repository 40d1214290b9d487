"""How cost grows with size: ``python -m tests.benchmarks.scale``.

Processor seconds of one core, and peak memory beyond that of the program itself, while one size
grows and the others stay as in ``configs/quick.yaml``: trajectories collected, horizon, hidden
size, members of the ensemble, samples of a forecast. Every point is measured once, in a process of
its own, since the peak of a process never falls.

*Collect, no physics* is the stage with constant numbers in place of MuJoCo's. It shows the memory
of data sets that would take long to simulate.
"""

import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from study.config.settings import Config
from tests.benchmarks.costs import Cost, collection, forecasting, training
from tests.benchmarks.report import save
from tests.benchmarks.timing import as_a_worker

SAMPLES = 40


@dataclass(frozen=True)
class Series:
    """The cost of some work as one size grows; `measure` runs in a process of its own."""

    setting: str
    work: str
    sizes: tuple[int, ...]
    measure: Callable[[int], Cost]


def resized(setting: str, size: int) -> tuple[Config, int, int | None]:
    """The quick configuration, the samples of a forecast and the horizon, with one of them set."""
    base, samples, horizon = Config(), SAMPLES, None
    if setting == "hidden size":
        base = replace(
            base,
            ensemble=replace(base.ensemble, hidden_size=size),
            sections={
                name: replace(base.section(name), hidden_size=size) for name in ("vae", "mlp")
            },
        )
    elif setting == "members":
        base = replace(base, ensemble=replace(base.ensemble, members=size))
    elif setting == "samples":
        samples = size
    else:
        horizon = size
    return base, samples, horizon


def step(name: str, setting: str, size: int) -> Cost:
    """The cost of a training step."""
    config, _, horizon = resized(setting, size)
    return training(name, config, horizon)


def forecast(name: str, setting: str, size: int) -> Cost:
    """The cost of the forecasts of all scenarios."""
    config, samples, horizon = resized(setting, size)
    return forecasting(name, config, samples, horizon)


def every_series() -> Iterator[Series]:
    """What is measured."""
    simulated, constant = partial(collection, physics=True), partial(collection, physics=False)
    yield Series("trajectories", "collect", (500, 1000, 2000), simulated)
    sizes: tuple[int, ...] = (1000, 3000, 10_000, 30_000, 100_000)
    yield Series("trajectories", "collect, no physics", sizes, constant)
    growing = {"horizon": (30, 60, 120, 240, 480), "hidden size": (32, 64, 128, 256)}
    for name in ("full_vae", "probabilistic_mlp"):
        for setting, sizes in growing.items():
            yield Series(setting, f"{name}, step", sizes, partial(step, name, setting))
            yield Series(setting, f"{name}, forecast", sizes, partial(forecast, name, setting))
    sizes, name = (1, 2, 5, 10), "residual_vae"
    yield Series("members", "ensemble, step", sizes, partial(step, "ensemble", "members"))
    yield Series("members", f"{name}, forecast", sizes, partial(forecast, name, "members"))
    sizes = (10, 30, 100, 300, 1000, 2000)
    yield Series("samples", f"{name}, forecast", sizes, partial(forecast, name, "samples"))


def exponent(sizes: tuple[int, ...], values: list[float]) -> float:
    """The exponent p of value ~ size^p, fitted to the upper half of the sizes."""
    upper = slice((len(sizes) - 1) // 2, None)
    return float(np.polyfit(np.log(sizes[upper]), np.log(values[upper]), 1)[0])


def main() -> None:
    """Measure, print and save."""
    as_a_worker()
    # Processes are forked from one that has imported everything and done nothing else.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.benchmarks.costs"])
    rows = []
    for series in every_series():
        costs = []
        for size in series.sizes:
            with ProcessPoolExecutor(1, mp_context=context) as pool:
                future: Future[Cost] = pool.submit(series.measure, size)
                costs.append(future.result())
        seconds = [cost.seconds for cost in costs]
        rows.append(
            {
                "setting": series.setting,
                "work": series.work,
                "sizes": series.sizes,
                "seconds": seconds,
                "memory": [cost.memory for cost in costs],
                "exponent": exponent(series.sizes, seconds),
            }
        )
        print(f"{series.setting}: {series.work}", flush=True)
        for size, cost in zip(series.sizes, costs, strict=True):
            print(f"  {size:8,} {cost.seconds:9.3f} s {cost.memory / 1e6:9.1f} MB", flush=True)
    save("scale", rows)


if __name__ == "__main__":
    main()
