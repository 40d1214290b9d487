"""The data sets of a simulator: a value that is not finite is named."""

from collections.abc import Iterator

import numpy as np
import pytest

from study.common.arrays import Floats
from study.common.errors import StudyError
from study.common.progress import Progress
from study.common.seeds import Seeds
from study.envs import Rollout, Scenarios
from study.envs.observe import observe_scenarios, observe_trajectories
from study.examples.cart import Cart


class Broken(Cart):
    """The seventh of many trajectories is lost at step 3; or a goal or a plan is."""

    lost = "states"
    calls = 0
    fine = 0
    """Calls of `rollout` before the first with a lost trajectory."""

    def sample_scenarios(self, seeds: Seeds) -> Scenarios:
        scenarios = super().sample_scenarios(seeds)
        if self.lost == "goal":
            scenarios.goal[2] = np.inf
        return scenarios

    def plan(self, scenarios: Scenarios, seeds: Seeds) -> Floats:
        actions = super().plan(scenarios, seeds)
        if self.lost == "actions":
            actions[2, 4] = np.nan
        return actions

    def rollout(self, s0: Floats, actions: Floats, seeds: Seeds | None = None) -> Rollout:
        rollout = super().rollout(s0, actions, seeds)
        self.calls += 1
        if self.lost == "states" and self.calls > self.fine:
            rollout.states[6, 3:, 1] = np.nan
        return rollout


def drain(parts: Iterator[object]) -> None:
    for _ in parts:
        pass


def test_a_lost_trajectory_of_the_training_set() -> None:
    error = "cart, training set: trajectory 6, step 3: v is nan"
    with pytest.raises(StudyError, match=error):
        drain(observe_trajectories(Broken(), 40, 0, Progress()))


def test_its_number_is_that_in_the_whole_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("study.envs.observe.CHUNK", 10)
    monkeypatch.setattr(Broken, "fine", 2)
    with pytest.raises(StudyError, match="trajectory 26, step 3"):
        drain(observe_trajectories(Broken(), 40, 0, Progress()))


@pytest.mark.parametrize("name", ["validation", "test"])
def test_a_lost_rollout_of_a_scenario(name: str) -> None:
    error = f"cart, {name} set: scenario 1, rollout 2, step 3: v is nan"
    with pytest.raises(StudyError, match=error):
        drain(observe_scenarios(Broken(), 5, 4, 0, Progress(), name))


@pytest.mark.parametrize(
    ("lost", "error"),
    [("goal", "scenario 2: target is inf"), ("actions", "scenario 2, step 4: force is nan")],
)
def test_a_lost_goal_or_plan(lost: str, error: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Broken, "lost", lost)
    with pytest.raises(StudyError, match=error):
        drain(observe_scenarios(Broken(), 5, 4, 0, Progress()))
