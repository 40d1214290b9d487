"""How fast forecasts are scored by MMD: ``python -m tests.benchmarks.evaluation``.

One Pusher cell at paper size, 250 scenarios × 100 forecasts × 100 rollouts × 120 steps × 12
dimensions, each contender in a process of its own, in turn. Its peak memory includes the data:

- *ours*: `study.metrics.mmd.mmd`, on one thread;
- *kernel matrices*: the direct computation in torch, float32, on all cores: matrices of one
  scenario at a time, all steps of a dimension at once;
- *three bandwidths*, *scenarios pooled*, *joint*: MMD² at three bandwidths, over all scenarios, of
  whole states.

The data is artificial. Rollouts are normal, and their standard deviation grows over the horizon
from a hundredth of the scale to the scale. Forecasts are shifted a little, and one in a thousand is
larger a hundredfold.
"""

import argparse
import multiprocessing
import resource
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import torch

from study.common.arrays import Array
from study.metrics.joint_mmd import joint_mmd
from study.metrics.mmd import bandwidths, mmd, normalize, pooled, sensitivity
from tests.benchmarks.report import save
from tests.benchmarks.timing import cores

Squared = Callable[[Array, Array, Array, Array], Array]
OURS, MATRICES = "ours", "kernel matrices"
LARGEST_DIFFERENCE = 1e-6
"""Between ours and the direct computation; more is an error of one of them."""


def kernel_matrices(forecast: Array, observed: Array, scale: Array, bandwidth: Array) -> Array:
    """Unbiased MMD² [S, T, D]."""
    scenarios, rollouts, steps, dimensions = observed.shape
    samples = forecast.shape[1]
    squared = np.empty((scenarios, steps, dimensions))
    for scenario in range(scenarios):
        pair = normalize(forecast[scenario], observed[scenario], scale, bandwidth)
        for d in range(dimensions):
            x, y = (torch.from_numpy(z[..., d].T.astype(np.float32)) for z in pair)
            among_x, among_y, across = (
                torch.exp(-((a[:, :, None] - b[:, None]) ** 2)).sum((1, 2), dtype=torch.float64)
                for a, b in ((x, x), (y, y), (x, y))
            )
            squared[scenario, :, d] = (
                (among_x - samples) / (samples * (samples - 1))
                + (among_y - rollouts) / (rollouts * (rollouts - 1))
                - 2 * across / (samples * rollouts)
            ).numpy()
    return squared


CONTENDERS: dict[str, Squared] = {
    OURS: lambda *arrays: mmd(*arrays).squared,
    MATRICES: kernel_matrices,
    "three bandwidths": lambda *arrays: sensitivity(*arrays)[0].squared,
    "scenarios pooled": lambda *arrays: pooled(*arrays).squared,
    "joint": lambda *arrays: joint_mmd(*arrays).squared,
}


def artificial(shape: tuple[int, int, int, int, int]) -> tuple[Array, Array]:
    """Forecasts [S, K, T, D] and observed rollouts [S, L, T, D]."""
    scenarios, samples, rollouts, steps, dimensions = shape
    rng = np.random.default_rng(0)
    deviation = np.linspace(0.01, 1, steps, dtype=np.float32)[:, None]

    def normal(count: int) -> Array:
        return rng.standard_normal((scenarios, count, steps, dimensions), dtype=np.float32)

    forecast, observed = normal(samples), normal(rollouts)
    forecast += np.float32(0.3)
    forecast[rng.random((scenarios, samples)) < 1e-3] *= 100
    forecast *= deviation
    observed *= deviation
    return forecast, observed


def measure(name: str, shape: tuple[int, int, int, int, int]) -> tuple[float, float, Array]:
    """Seconds, peak memory in GB, and MMD²."""
    torch.set_num_threads(cores() if name == MATRICES else 1)
    forecast, observed = artificial(shape)
    scale = np.ones(shape[-1])
    bandwidth = bandwidths(observed[:8], scale)
    start = time.perf_counter()
    squared = CONTENDERS[name](forecast, observed, scale, bandwidth)
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # Bytes on macOS, kibibytes elsewhere.
    return seconds, peak * (1 if sys.platform == "darwin" else 1024) / 1e9, squared


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scenarios", type=int, default=250)
    parser.add_argument("--samples", type=int, default=100)
    arguments = parser.parse_args()
    shape = (arguments.scenarios, arguments.samples, arguments.samples, 120, 12)
    rows, ours = [], np.empty(0)
    for name in CONTENDERS:
        # A process each: peak memory is the process's, and never falls.
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            seconds, gigabytes, squared = pool.submit(measure, name, shape).result()
        ours = squared if name == OURS else ours
        difference = float(np.abs(ours - squared).max()) if name == MATRICES else None
        assert difference is None or difference < LARGEST_DIFFERENCE, difference
        rows.append(
            {
                "contender": name,
                "seconds": seconds,
                "gigabytes": gigabytes,
                "difference": difference,
            }
        )
        print(f"{name:18} {seconds:7.1f} s {gigabytes:6.2f} GB", flush=True)
    save("evaluation", rows)


if __name__ == "__main__":
    main()
