"""MuJoCo's bodies and shapes in Rerun's conventions."""

import numpy as np
import pytest

from study.recording import scenes
from tests.helpers import recordings


def test_poses_and_the_capsule_are_where_mujoco_has_them() -> None:
    model = recordings.Puck().scene()
    qpos = np.array([[0.3, -0.2, 0.0], [0.0, 0.0, np.pi / 2]])
    positions, rotations = scenes.body_poses(model, qpos)
    puck = model.body("puck").id
    np.testing.assert_allclose(positions[0, puck], [0.3, -0.2, 0.05], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(rotations, axis=-1), 1, atol=1e-6)
    np.testing.assert_allclose(rotations[0, puck], [0, 0, 0, 1], atol=1e-6)  # xyzw
    rod = model.geom("rod").id
    half = model.geom_size[rod, 1]
    start = scenes.capsule_start(model.geom_pos[rod], model.geom_quat[rod], half)
    ends = sorted([0.0, 0.3], key=lambda y: abs(y - start[1]))
    np.testing.assert_allclose(start, [0, ends[0], 0], atol=1e-6)


def test_a_configuration_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="qpos: got 9 numbers; the model has 3"):
        scenes.body_poses(recordings.Puck().scene(), np.zeros((1, 9)))


def test_states_count_up_to_the_first_that_is_not_finite() -> None:
    states = np.zeros((5, 2), dtype=np.float32)
    assert scenes.finite_steps(states) == 5
    states[3, 1] = np.inf
    assert scenes.finite_steps(states) == 3
    states[0, 0] = np.nan
    assert scenes.finite_steps(states) == 1
