"""Standard normal noise for a batch of trajectories, each with its own generator."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


class Noise:
    """Standard normal numbers [N, *shape], one control step after the other.

    The numbers of a trajectory come from its own generator, in the order of the control steps. So
    they depend neither on the batch nor on `noise_steps`.

    Args:
        generators: N generators, one for each trajectory.
        shape: shape of the numbers of one control step.
        noise_steps: control steps whose numbers are sampled together.
        dtype: float32 or float64.
    """

    def __init__(
        self,
        generators: Sequence[np.random.Generator],
        shape: tuple[int, ...],
        noise_steps: int,
        dtype: type[np.float32] | type[np.float64] = np.float64,
    ) -> None:
        self._generators, self._dtype = generators, dtype
        self._samples = np.empty((len(generators), noise_steps, *shape), dtype)
        self._next = noise_steps

    def step(self) -> NDArray[np.floating]:
        """The numbers of the next control step, [N, *shape]."""
        if self._next == self._samples.shape[1]:
            for row, generator in zip(self._samples, self._generators, strict=True):
                generator.standard_normal(out=row, dtype=self._dtype)
            self._next = 0
        self._next += 1
        return self._samples[:, self._next - 1]
