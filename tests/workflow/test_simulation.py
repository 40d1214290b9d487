"""The estimated duration of tasks on many workers: by hand, and within the bounds of any order."""

import numpy as np
import pytest

from study.workflow.simulation import critical_path, simulate
from study.workflow.task import Task


def _task(name: str, *inputs: Task) -> Task:
    return Task("train", name, {"name": name}, {task.label: task for task in inputs})


DATA = _task("data")
SHORT = [_task(f"short {index}", DATA) for index in range(3)]
MIDDLE = _task("middle", DATA)
LAST = _task("last", MIDDLE)
TASKS = [DATA, *SHORT, MIDDLE, LAST]
SECONDS = {DATA: 10.0, **dict.fromkeys(SHORT, 4.0), MIDDLE: 6.0, LAST: 5.0}


@pytest.mark.parametrize(
    ("workers", "expected"),
    # On two workers `middle` runs beside two short tasks, the third one follows at 16 s, and
    # `last` runs from 18 s.
    [(1, 10 + 3 * 4 + 6 + 5), (2, 10 + 2 * 4 + 5), (3, 10 + 6 + 5), (100, 10 + 6 + 5)],
)
def test_a_small_study_by_hand(workers: int, expected: float) -> None:
    forecast = simulate(TASKS, SECONDS, workers)
    assert forecast.seconds == expected
    assert forecast.busy == pytest.approx(sum(SECONDS.values()) / (workers * expected))


def test_the_longest_chain() -> None:
    assert critical_path(TASKS, SECONDS) == [DATA, MIDDLE, LAST]
    assert critical_path(TASKS, SECONDS | {SHORT[1]: 12.0}) == [DATA, SHORT[1]]


def test_inputs_that_are_complete_take_no_time() -> None:
    assert simulate([MIDDLE, LAST], SECONDS, 2).seconds == 11
    assert critical_path([MIDDLE, LAST], SECONDS) == [MIDDLE, LAST]


def test_nothing_to_run() -> None:
    assert simulate([], {}, 4).seconds == 0
    assert critical_path([], {}) == []


def test_the_bounds_of_list_scheduling() -> None:
    """No order is faster than the longest chain or the mean load; none without idle workers is
    slower than their sum (Graham 1969)."""
    random = np.random.default_rng(0)
    for workers in (1, 3, 16):
        tasks: list[Task] = []
        for index in range(200):
            count = min(index, int(random.integers(3)))
            inputs = [tasks[i] for i in random.choice(max(index, 1), count, replace=False)]
            tasks.append(_task(f"{index}", *inputs))
        seconds = {task: float(random.exponential(10)) for task in tasks}
        chain = sum(seconds[task] for task in critical_path(tasks, seconds))
        load = sum(seconds.values()) / workers
        found = simulate(tasks, seconds, workers).seconds
        assert max(chain, load) <= found + 1e-9
        assert found <= chain + load + 1e-9
