"""The random numbers of forecasts. The numbers of a scenario depend on its seed alone."""

import numpy as np
from torch import Tensor

from study.common.arrays import Floats, Integers
from study.common.seeds import Seeds


def sample_noise(seeds: Seeds, samples: int, horizon: int, size: int) -> Floats:
    """Standard normal numbers [S, K, T, size], from the scenarios' seeds [S]."""
    noise = np.empty((len(seeds), samples, horizon, size), np.float32)
    for scenario, seed in enumerate(seeds):
        generator = np.random.default_rng([int(seed), 0])
        generator.standard_normal(dtype=np.float32, out=noise[scenario])
    return noise


def sample_members(seeds: Seeds, samples: int, members: int) -> Integers:
    """m ~ U{0 … M−1} [S, K]: one for the whole horizon of a sample (Algorithm 1, line 4)."""
    return np.stack(
        [np.random.default_rng([int(seed), 1]).integers(members, size=samples) for seed in seeds]
    )


def repeat_samples(values: Tensor, samples: int) -> Tensor:
    """Repeat the row of each scenario for its K samples: [S·K, ...] from [S, ...]."""
    return values.repeat_interleave(samples, dim=0)
