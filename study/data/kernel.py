"""The kernel of a system's MMD: the scale and bandwidth of each dimension of its state."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from study.common.arrays import Doubles
from study.common.files import read_json, write_json

NAME = "kernel.json"


@dataclass(frozen=True)
class Kernel:
    """In what units forecasts are compared, the same for every model of an environment.

    Attributes:
        names: D names of the state's dimensions.
        scale: [D], standard deviations of the training data, SI units.
        bandwidth: [D], of the Gaussian kernel, in units of `scale`.
    """

    names: tuple[str, ...]
    scale: Doubles
    bandwidth: Doubles

    def save(self, folder: Path) -> None:
        """Write ``kernel.json`` into a folder."""
        values = {"scale": self.scale.tolist(), "bandwidth": self.bandwidth.tolist()}
        write_json(folder / NAME, {"names": list(self.names)} | values)

    @classmethod
    def load(cls, folder: Path) -> "Kernel":
        """Read what `save` wrote."""
        kernel = read_json(folder / NAME)
        scale, bandwidth = np.array(kernel["scale"]), np.array(kernel["bandwidth"])
        return cls(tuple(kernel["names"]), scale, bandwidth)
