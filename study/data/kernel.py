"""The kernel of an environment's MMD: the scale and bandwidth of each state dimension."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from study.common.arrays import Doubles
from study.common.files import read_json, write_json

FILE_NAME = "kernel.json"


@dataclass(frozen=True)
class Kernel:
    """Scales and bandwidths; all models of an environment are scored with the same.

    Attributes:
        names: D names of the state variables.
        scale: [D] standard deviations of the training data, SI units.
        bandwidth: [D] bandwidths of the Gaussian kernel, in units of `scale`.
    """

    names: tuple[str, ...]
    scale: Doubles
    bandwidth: Doubles

    def save(self, folder: Path) -> None:
        """Write ``kernel.json`` into a folder."""
        values = {
            "names": list(self.names),
            "scale": self.scale.tolist(),
            "bandwidth": self.bandwidth.tolist(),
        }
        write_json(folder / FILE_NAME, values)

    @classmethod
    def load(cls, folder: Path) -> "Kernel":
        """Read what `save` wrote."""
        values = read_json(folder / FILE_NAME)
        scale, bandwidth = np.array(values["scale"]), np.array(values["bandwidth"])
        return cls(tuple(values["names"]), scale, bandwidth)
