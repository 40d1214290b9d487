"""Reference forecasters of a recorded system, which has no oracle: they need data and no training.

====================  ==============================================================================
training_climatology  the states of K training windows at each step, whatever s_0 and the actions
                      are
persistence           s_0, plus the change by each step in K training windows, whatever s_0 and the
                      actions are: a persistence forecast with the variance of the data
analogues             s_0, plus the change by each step in the training windows that began most
                      alike and had the most similar actions (Lorenz, J. Atmos. Sci. 26, 1969)
====================  ==============================================================================

The distance of two windows is the mean squared difference of s_0 over its D components, plus the
mean squared difference of the actions over steps and components, in standard deviations of the
training data. The number of analogues is the one of `NEIGHBOURS` with the lowest CRPS of the
validation windows.
"""

from dataclasses import dataclass

import numpy as np

from study.common.arrays import Doubles, Floats, Integers
from study.common.errors import BadInput
from study.common.seeds import Seeds
from study.config.names import ANALOGUES, CLIMATOLOGY
from study.data.trajectories import ScenarioSet, Trajectories
from study.metrics.mmd import nonzero_scale
from study.metrics.proper_scores import crps
from study.models.base import Forecaster

NEIGHBOURS = (1, 2, 5, 10, 20, 50, 100)
"""Numbers of analogues that are tried; at most the number of samples."""
SCENARIOS = 64
"""Scenarios whose distances to all training windows are in memory together."""


@dataclass(frozen=True)
class Climatology:
    """Random training windows as they are."""

    training: Trajectories

    def forecast(self, s0: Floats, actions: Floats, samples: int, seeds: Seeds) -> Floats:
        """See `Forecaster.forecast`."""
        _check_horizon(self.training, actions)
        steps = actions.shape[1]
        rows = _random_rows(len(self.training), samples, seeds)
        return self.training.states[rows, 1 : steps + 1]


@dataclass(frozen=True)
class Persistence:
    """The initial state, with the changes of random training windows."""

    training: Trajectories

    def forecast(self, s0: Floats, actions: Floats, samples: int, seeds: Seeds) -> Floats:
        """See `Forecaster.forecast`."""
        _check_horizon(self.training, actions)
        rows = _random_rows(len(self.training), samples, seeds)
        return _with_changes(self.training, s0, rows, actions.shape[1])


class Analogues:
    """The initial state, with the changes of the training windows that are most alike.

    With fewer analogues than samples, each is taken several times.
    """

    def __init__(self, training: Trajectories, validation: ScenarioSet) -> None:
        self.training, self.validation = training, validation
        self.state_scale = nonzero_scale(training.states.std(axis=(0, 1), dtype=np.float64))
        self.action_scale = nonzero_scale(training.actions.std(axis=(0, 1), dtype=np.float64))
        self._chosen: dict[int, int] = {}

    def forecast(self, s0: Floats, actions: Floats, samples: int, seeds: Seeds) -> Floats:
        """See `Forecaster.forecast`. The forecasts do not depend on the seeds."""
        _check_horizon(self.training, actions)
        if samples not in self._chosen:
            self._chosen[samples] = self.neighbours(samples)
        return self.of_nearest(s0, actions, samples, self._chosen[samples])

    def neighbours(self, samples: int) -> int:
        """The number of analogues with the lowest CRPS of the validation windows."""
        validation = self.validation
        inputs = (validation.s0, validation.actions, samples)

        def score(count: int) -> float:
            forecasts = self.of_nearest(*inputs, count)
            return float(crps(forecasts, validation.observed, self.state_scale).mean())

        return min((count for count in NEIGHBOURS if count <= samples), key=score)

    def of_nearest(self, s0: Floats, actions: Floats, samples: int, count: int) -> Floats:
        """The forecasts [S, K, T, D] from the `count` nearest windows."""
        steps = actions.shape[1]
        known = self._features(self.training.states[:, 0], self.training.actions[:, :steps])
        rows = []
        for start in range(0, len(s0), SCENARIOS):
            chunk = slice(start, start + SCENARIOS)
            wanted = self._features(s0[chunk], actions[chunk])
            rows.append(_nearest(wanted, known, count))
        nearest_rows = np.concatenate(rows)
        repeated = nearest_rows[:, np.arange(samples) % nearest_rows.shape[1]]
        return _with_changes(self.training, s0, repeated, steps)

    def _features(self, s0: Floats, actions: Floats) -> Floats:
        """[N, D + T·A], whose squared distance is that of the module."""
        count, steps, size = actions.shape
        state = s0 / self.state_scale / np.sqrt(s0.shape[1])
        action = actions / self.action_scale / np.sqrt(steps * size)
        return np.concatenate([state, action.reshape(count, -1)], axis=1).astype(np.float32)


def reference(name: str, training: Trajectories, validation: ScenarioSet) -> Forecaster:
    """A reference forecaster.

    Args:
        name: one of `study.config.names.FROM_DATA`.
        training: the windows from which it forecasts.
        validation: windows by which it chooses the number of analogues.
    """
    if name == ANALOGUES:
        return Analogues(training, validation)
    return Climatology(training) if name == CLIMATOLOGY else Persistence(training)


def _random_rows(count: int, samples: int, seeds: Seeds) -> Integers:
    """Rows of training windows [S, K], without repetition where there are enough."""
    rows = np.empty((len(seeds), samples), np.int64)
    for scenario, seed in enumerate(seeds):
        generator = np.random.default_rng(int(seed))
        rows[scenario] = generator.choice(count, samples, replace=samples > count)
    return rows


def _with_changes(training: Trajectories, s0: Floats, rows: Integers, steps: int) -> Floats:
    """s_0 plus the changes of the training windows `rows` [S, K], [S, K, T, D]."""
    states = training.states[rows, : steps + 1]
    return s0[:, None, None] + (states[:, :, 1:] - states[:, :, :1])


def _nearest(wanted: Floats, known: Floats, count: int) -> Integers:
    """The rows of the `count` nearest of known [N, F] to each of wanted [S, F], nearest first."""
    distance: Doubles = (
        np.square(wanted).sum(1)[:, None] + np.square(known).sum(1) - 2 * wanted @ known.T
    )
    count = min(count, len(known))
    nearest_rows = np.argpartition(distance, count - 1, axis=1)[:, :count]
    order = np.argsort(np.take_along_axis(distance, nearest_rows, 1), axis=1, kind="stable")
    return np.asarray(np.take_along_axis(nearest_rows, order, 1))


def _check_horizon(training: Trajectories, actions: Floats) -> None:
    """Check that the training windows are as long as the actions.

    Raises:
        BadInput: they are shorter.
    """
    if actions.shape[1] > training.horizon:
        raise BadInput(
            f"a plan of {actions.shape[1]} steps; the training windows have {training.horizon}"
        )
