"""Names for typed NumPy arrays. Shapes stand in the docstrings: ``[S, K, T, D]``."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
"""Numbers of any type."""
Floats = NDArray[np.float32]
"""States, actions and forecasts, as files hold them."""
Doubles = NDArray[np.float64]
"""Scores, and whatever is summed."""
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]
Pixels = NDArray[np.uint8]
"""``[height, width, 3]``."""
