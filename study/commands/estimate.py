"""An estimate of the time that tasks take, from their settings and from tasks that have ended."""

from collections.abc import Iterable, Mapping
from statistics import fmean
from typing import Any

from study.workflow.store import Store
from study.workflow.task import Task

SECONDS = {
    "collect": 1.2e-3,
    "ensemble": 4.5e-2,
    "tune": 2.3e-2,
    "trial": 2.3e-2,
    "train": 2.0e-2,
    "evaluate": 8e-4,
}
"""Seconds of one core for each unit of `work`, with the networks of quick.yaml and paper.yaml."""
SMALLEST = 2.0
"""Seconds of a task at least, to start and to write its files."""
BATCH = 12
"""Trajectories in a batch of the networks of `SECONDS`."""


def estimate(due: Iterable[Task], ended: Iterable[Task], store: Store) -> float:
    """The seconds of one core that tasks take.

    A stage, environment and model of which tasks have ended take time in proportion to those.

    Args:
        due: the tasks to run.
        ended: tasks that have run, with timings in the store.
        store: the folders of the tasks.
    """
    measured = {task: store.timing(task).get("cpu_seconds") for task in ended}
    return sum(durations(due, measured).values())


def durations(due: Iterable[Task], measured: Mapping[Task, float | None]) -> dict[Task, float]:
    """The seconds of each task: measured, or in proportion to tasks of its kind that ran.

    Args:
        due: the tasks to run.
        measured: seconds of tasks that have run; None where they are unknown.
    """
    ratios: dict[tuple[str, ...], list[float]] = {}
    for task, seconds in measured.items():
        if seconds:
            for kind in _kinds(task):
                ratios.setdefault(kind, []).append(float(seconds) / _expected(task))

    def expected(task: Task) -> float:
        found = [ratios[kind] for kind in _kinds(task) if kind in ratios]
        return _expected(task) * (fmean(found[0]) if found else 1.0)

    return {task: measured.get(task) or expected(task) for task in due}


def in_words(seconds: float) -> str:
    """A duration: `40 s`, `12 min` or `3.5 h`."""
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _kinds(task: Task) -> list[tuple[str, ...]]:
    """Stage, environment and model, and stage and environment, where no task of the model ran."""
    environment, *others = task.label.split("/")
    model = others[1:2] if len(others) > 2 else []  # a trial has its number last
    return [(task.stage, environment, *model), (task.stage, environment)]


def _expected(task: Task) -> float:
    return max(SMALLEST, SECONDS.get(task.stage, SMALLEST) * work(task))


def work(task: Task) -> float:
    """Optimiser steps of batches of 12, trajectories to observe, or forecasts to score."""
    settings = task.settings
    if task.stage == "collect":
        collect = settings["collect"]
        return float(collect["trajectories"] + collect["scenarios"] * collect["rollouts"])
    if task.stage == "ensemble":
        return _steps(settings["ensemble"])
    if task.stage == "train":
        return _steps(settings["model_settings"]["train"])
    if task.stage in ("tune", "trial"):
        train, tune = settings["fit"]["model_settings"]["train"], settings["tune"]
        trials = tune["trials"] if task.stage == "tune" else 1
        return float(trials * tune["steps"]) * train["batch_size"] / BATCH
    if task.stage == "evaluate":
        data = task.inputs["data"].settings["collect"]
        return float(data["scenarios"] * settings["evaluate"]["samples"])
    return 1.0


def _steps(fit: Mapping[str, Any]) -> float:
    return float(fit["steps"] * fit["batch_size"]) / BATCH
