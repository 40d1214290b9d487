"""How fast forecasts are scored by MMD: ``python -m tests.benchmarks.evaluation``.

One Pusher cell at paper scale, 250 scenarios × 100 forecasts × 100 rollouts × 120 steps × 12
dimensions, each contender in a process of its own, in turn; its peak memory includes the data:

- *ours*: `study.metrics.mmd.mmd`;
- *torch*: the straightforward version: kernel matrices of one scenario at a time, all steps of one
  dimension at once, float32;
- *sensitivity*, *pooled*, *joint*: MMD² at three bandwidths, over all scenarios, of whole states.

The data is made up: rollouts are normal, their spread grows over the horizon from a hundredth of
the scale to the scale; forecasts are off by a little, and one in a thousand by a hundredfold. The
bandwidth is the median heuristic's, or `--bandwidth` of the scale for all dimensions.
"""

import argparse
import multiprocessing
import os
import resource
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import torch

from study.common.arrays import Array
from study.metrics.joint_mmd import joint_mmd
from study.metrics.mmd import bandwidths, mmd, pooled, sensitivity, standardise

Squared = Callable[[Array, Array, Array, Array], Array]

SECONDS, GIGABYTES, RATIO, APART = 30, 2, 3, 1e-6
"""What ours should keep to: at most, at most, at least so much faster than torch, at most."""


def straightforward(forecast: Array, observed: Array, scale: Array, bandwidth: Array) -> Array:
    """Unbiased MMD² [S, T, D] by kernel matrices."""
    scenarios, rollouts, steps, dimensions = observed.shape
    samples = forecast.shape[1]
    squared = np.empty((scenarios, steps, dimensions))
    for scenario in range(scenarios):
        pair = standardise(forecast[scenario], observed[scenario], scale, bandwidth)
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
    "ours": lambda *given: mmd(*given).squared,
    "torch": straightforward,
    "sensitivity": lambda *given: sensitivity(*given)[0].squared,
    "pooled": lambda *given: pooled(*given).squared,
    "joint": lambda *given: joint_mmd(*given).squared,
}


def made_up(shape: tuple[int, int, int, int, int]) -> tuple[Array, Array]:
    """Forecasts [S, K, T, D] and observed rollouts [S, L, T, D]."""
    scenarios, samples, rollouts, steps, dimensions = shape
    rng = np.random.default_rng(0)
    spread = np.linspace(0.01, 1, steps, dtype=np.float32)[:, None]

    def normal(count: int) -> Array:
        return rng.standard_normal((scenarios, count, steps, dimensions), dtype=np.float32)

    forecast, observed = normal(samples), normal(rollouts)
    forecast += np.float32(0.3)
    forecast[rng.random((scenarios, samples)) < 1e-3] *= 100
    forecast *= spread
    observed *= spread
    return forecast, observed


def measure(
    name: str, shape: tuple[int, int, int, int, int], bandwidth: float, threads: int
) -> tuple[float, float, Array]:
    """Seconds, peak memory in GB, and the numbers."""
    torch.set_num_threads(threads)
    forecast, observed = made_up(shape)
    scale = np.ones(shape[-1])
    width = np.full(shape[-1], bandwidth) if bandwidth else bandwidths(observed[:8], scale)
    start = time.perf_counter()
    squared = CONTENDERS[name](forecast, observed, scale, width)
    seconds = time.perf_counter() - start
    return seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, squared


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("contenders", nargs="*", metavar="NAME", help="which ones; all by default")
    parser.add_argument("--scenarios", type=int, default=250)
    parser.add_argument("--samples", type=int, default=100)
    parser.add_argument("--steps", type=int, default=120)
    parser.add_argument("--dimensions", type=int, default=12)
    parser.add_argument("--bandwidth", type=float, default=0.0, help="of the scale; 0: the median")
    parser.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)))
    given = parser.parse_args()
    shape = (given.scenarios, given.samples, given.samples, given.steps, given.dimensions)
    print(f"S K L T D = {shape}, {given.threads} threads, load {os.getloadavg()[0]:.1f}")
    found = {}
    for name in given.contenders or CONTENDERS:
        # A process each: peak memory is the process's, and never falls.
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            arguments = (name, shape, given.bandwidth, given.threads)
            found[name] = pool.submit(measure, *arguments).result()
        seconds, memory, squared = found[name]
        print(f"  {name:12} {seconds:7.1f} s {memory:6.2f} GB   mean MMD² {squared.mean():.6f}")
    if "ours" in found:
        seconds, memory, ours = found["ours"]
        print(f"  at most {SECONDS} s: {_yes(seconds <= SECONDS)}")
        print(f"  at most {GIGABYTES} GB: {_yes(memory <= GIGABYTES)}")
    if {"ours", "torch"} <= set(found):
        slow, _, theirs = found["torch"]
        ratio, apart = slow / seconds, np.abs(ours - theirs).max()
        print(f"  {ratio:.1f} × torch, at least {RATIO}: {_yes(ratio >= RATIO)}")
        print(f"  largest difference {apart:.1e}, at most {APART}: {_yes(apart <= APART)}")


def _yes(holds: bool) -> str:
    return "yes" if holds else "no"


if __name__ == "__main__":
    main()
