"""The example system with a bimodal step."""

import numpy as np

from study import check_simulator
from study.common.seeds import spawn
from study.examples.fork import DAMPING, HOP, NOISE_STD, Fork


def test_it_is_a_simulator() -> None:
    check_simulator(Fork)


def test_every_step_has_two_modes() -> None:
    count, simulator = 2000, Fork(horizon=3)
    s0 = np.full((count, 1), 0.5, np.float32)
    actions = np.full((count, 3, 1), 0.1, np.float32)
    states = simulator.rollout(s0, actions, spawn(0, count)).states[:, :, 0]
    hops = states[:, 1:] - DAMPING * states[:, :-1] - 0.1
    assert np.abs(np.abs(hops) - HOP).max() < 5 * NOISE_STD
    np.testing.assert_allclose((hops > 0).mean(0), 0.5, atol=0.05)
    assert (np.abs(states[:, 1:] - 0.1) > 0.3).all(), "no state between the modes"


def test_the_nominal_system_does_not_hop() -> None:
    simulator = Fork(horizon=2)
    states = simulator.rollout(np.ones((1, 1), np.float32), np.zeros((1, 2, 1), np.float32)).states
    np.testing.assert_allclose(states[0, :, 0], [1, DAMPING, DAMPING**2], rtol=1e-6)
