"""Roll, pitch and yaw of quaternions, for logs that hold orientations as quaternions."""

import numpy as np

from study.common.arrays import Array, Doubles


def euler(w: Array, x: Array, y: Array, z: Array) -> dict[str, Doubles]:
    """Roll, pitch and yaw in rad [N] of quaternions, in the order yaw, pitch, roll (Z-Y-X).

    Args:
        w: real part, [N].
        x: first imaginary part, [N].
        y: second imaginary part, [N].
        z: third imaginary part, [N].
    """
    w, x, y, z = (np.asarray(part, np.float64) for part in (w, x, y, z))
    with np.errstate(invalid="ignore"):
        sine = np.clip(2 * (w * y - z * x), -1, 1)
        return {
            "roll": np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
            "pitch": np.arcsin(sine),
            "yaw": np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
        }
