"""The viewpoints of 3D scenes."""

import numpy as np
import rerun.blueprint as rrb

from study.recording import viewpoint


def test_the_eye_looks_at_a_flight_from_the_side_and_at_a_table_from_above() -> None:
    along = np.linspace([0.0, 0.0, 20.0], [100.0, 0.0, 30.0], 50, dtype=np.float32)[None]
    beside = _position(viewpoint.eye(along, along[0, -1]))
    assert abs(beside[0] - 50) < 1  # across the direction of flight, from the south
    assert beside[1] < -50
    flat = along * np.array([1, 1, 0], dtype=np.float32)
    above = _position(viewpoint.eye(flat, flat[0, -1]))
    assert above[2] > 2 * abs(above[1])


def _position(eye: rrb.EyeControls3D) -> np.ndarray:
    assert eye.position is not None
    return np.asarray(eye.position.as_arrow_array().to_pylist()[0])
