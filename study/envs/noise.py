"""Noise: standard normal numbers for many trajectories, each from a generator of its own."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


class Noise:
    """Standard normal numbers [N, *shape], one control step after the other.

    A trajectory's numbers come from its own generator, one step after the other, so they depend
    neither on the batch around it nor on how many steps are drawn at once.

    Args:
        generators: one for each of the N trajectories.
        shape: of one step's numbers.
        ahead: steps that are drawn at once.
        dtype: float32 or float64.
    """

    def __init__(
        self,
        generators: Sequence[np.random.Generator],
        shape: tuple[int, ...],
        ahead: int,
        dtype: type[np.float32] | type[np.float64] = np.float64,
    ) -> None:
        self._generators, self._dtype = generators, dtype
        self._drawn = np.empty((len(generators), ahead, *shape), dtype)
        self._next = ahead

    def step(self) -> NDArray[np.floating]:
        """The next step's numbers, [N, *shape]."""
        if self._next == self._drawn.shape[1]:
            for row, generator in zip(self._drawn, self._generators, strict=True):
                generator.standard_normal(out=row, dtype=self._dtype)
            self._next = 0
        self._next += 1
        return self._drawn[:, self._next - 1]
