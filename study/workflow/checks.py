"""Checks of a user's classes before the first long stage that uses them.

The checks are not part of a stage, so that no result depends on their source. The classes of the
study have tests instead.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from study.workflow.task import Task

TRAJECTORIES = 16
"""Number of training trajectories with which a model is checked."""


def check_classes(task: Task, inputs: Mapping[str, Path]) -> None:
    """Check the simulator of a stage collect, and the model of a stage tune, trial or train.

    Args:
        task: the task that runs next.
        inputs: complete folders of earlier stages, by name.

    Raises:
        StudyError: a class does not keep the contract of `Simulator` or `Model`.
    """
    if not task.plugins:
        return
    if task.stage == "collect":
        if task.settings["recorded"] is not None:
            return
        from study.envs import simulators
        from study.envs.check import check_foreign

        simulator = simulators[task.settings["environment"]]
        check_foreign(simulator, task.settings["collect"]["horizon"])
    elif task.stage in ("tune", "trial") or (task.stage == "train" and "tuning" not in inputs):
        _check_model(task.settings.get("fit", task.settings), inputs["data"])


def _check_model(fit: Mapping[str, Any], data: Path) -> None:
    """Check the model of a fit with a few of its training trajectories."""
    from study.config.convert import from_json
    from study.config.stage_settings import TrainingSet
    from study.models import models
    from study.models.check import Inputs, check_model
    from study.training.inputs import training_data

    model = models[fit["model"]]
    if not model.__module__.startswith("study.models."):
        data_set = training_data(from_json(TrainingSet, fit["training"]), data)
        training, normalization = data_set.training, data_set.normalization
        settings = from_json(model.settings_class, fit["model_settings"])
        check_model(model, inputs=Inputs(training[:TRAJECTORIES], normalization, settings))
