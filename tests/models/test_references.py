"""The references of a recorded system."""

from dataclasses import replace

import numpy as np
import pytest

from study.common.errors import BadInput
from study.common.seeds import spawn
from study.config.names import ANALOGUES, CLIMATOLOGY, FROM_DATA, PERSISTENCE
from study.data.trajectories import ScenarioSet, Trajectories
from study.models.references import Analogues, reference

COUNT, STEPS = 60, 5
RNG = np.random.default_rng(0)
ACTIONS = RNG.normal(size=(COUNT, STEPS, 1)).astype(np.float32)
START = RNG.normal(size=(COUNT, 1, 2)).astype(np.float32)
SUM = np.cumsum(ACTIONS, axis=1)
STATES = np.concatenate([START, START + np.concatenate([SUM, -SUM], axis=2)], axis=1)
NOTHING = np.empty((COUNT, 0), np.float32)
TRAINING = Trajectories(STATES, ACTIONS, NOTHING, NOTHING, {})
VALIDATION = ScenarioSet(
    STATES[:4, 0],
    ACTIONS[:4],
    NOTHING[:4],
    STATES[:4, None, 1:],
    np.empty((4, 1, 0), np.float32),
    {},
)
S0 = np.array([[5.0, 0.0], [0.0, -5.0]], np.float32)


@pytest.mark.parametrize("name", FROM_DATA)
def test_a_scenario_depends_on_its_own_seed_alone(name: str) -> None:
    forecaster, seeds = reference(name, TRAINING, VALIDATION), spawn(0, 2)
    both = forecaster.forecast(S0, ACTIONS[:2], 8, seeds)
    assert both.shape == (2, 8, STEPS, 2)
    assert both.dtype == np.float32
    alone = forecaster.forecast(S0[1:], ACTIONS[1:2], 8, seeds[1:])
    np.testing.assert_array_equal(both[1:], alone)


def test_climatology_forecasts_training_states_whatever_the_start_is() -> None:
    forecast = reference(CLIMATOLOGY, TRAINING, VALIDATION).forecast(
        S0, ACTIONS[:2], COUNT, spawn(0, 2)
    )
    expected = np.sort(STATES[:, 1:], axis=0)
    np.testing.assert_array_equal(np.sort(forecast[0], axis=0), expected)


def test_persistence_begins_at_the_start_and_has_the_changes_of_the_data() -> None:
    forecast = reference(PERSISTENCE, TRAINING, VALIDATION).forecast(
        S0, ACTIONS[:2], COUNT, spawn(0, 2)
    )
    changes = STATES[:, 1:] - STATES[:, :1]
    np.testing.assert_allclose(np.sort(forecast[0], axis=0), np.sort(S0[0] + changes, axis=0))


def test_analogues_find_the_trajectory_with_the_same_start_and_actions() -> None:
    start, actions = STATES[7:9, 0], ACTIONS[7:9]
    forecast = reference(ANALOGUES, TRAINING, VALIDATION).forecast(start, actions, 3, spawn(0, 2))
    np.testing.assert_allclose(forecast[:, 0], STATES[7:9, 1:], atol=1e-6)


def test_the_number_of_analogues_has_the_lowest_crps_on_the_validation_windows() -> None:
    """The validation windows are training windows, or noise that no window forecasts."""
    assert Analogues(TRAINING, VALIDATION).neighbours(40) == 1
    noise = np.random.default_rng(1).normal(size=(4, 1, STEPS, 2)).astype(np.float32)
    assert Analogues(TRAINING, replace(VALIDATION, observed=noise)).neighbours(40) > 1


def test_analogues_take_all_windows_again_if_there_are_few() -> None:
    forecast = Analogues(TRAINING[:3], VALIDATION).of_nearest(S0, ACTIONS[:2], 7, 5)
    np.testing.assert_array_equal(forecast[:, :3], forecast[:, 3:6])


def test_a_plan_that_is_too_long_is_refused() -> None:
    long = np.concatenate([ACTIONS, ACTIONS], axis=1)[:2]
    with pytest.raises(BadInput, match="a plan of 10 steps; the training windows have 5"):
        reference(PERSISTENCE, TRAINING, VALIDATION).forecast(S0, long, 3, spawn(0, 2))
