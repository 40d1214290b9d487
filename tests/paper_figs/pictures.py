"""Colours in the pictures that scripts write."""

from pathlib import Path

import matplotlib.image
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.typing import ColorType


def pixels_of(path: Path, colour: ColorType, tolerance: float = 0.01) -> int:
    """The number of pixels of a PNG within `tolerance` of a colour, in each of its channels."""
    picture = matplotlib.image.imread(path)[..., :3]
    return int((np.abs(picture - np.asarray(to_rgb(colour), np.float64)).max(-1) < tolerance).sum())


def size_of(path: Path) -> tuple[int, int]:
    """Width and height of a PNG, in pixels."""
    height, width = matplotlib.image.imread(path).shape[:2]
    return width, height
