"""Which stages a cell needs, and what each one depends on.

    collect ─► ensemble ─► tune β ─► train ─► evaluate ─► record
       └─► record_data ────────────────────────────────────►┘

A task depends on the settings that it is given here and on the tasks before it, and on nothing
else; what several cells share (data, an ensemble) is one task.
"""

from dataclasses import asdict
from typing import Any

from study.common.errors import BadInput
from study.common.seeds import derive
from study.config.grid import Cell
from study.config.settings import Config
from study.envs import simulators
from study.models import models
from study.workflow.store import Task

# Raise a stage's number whenever its code changes what it writes.
STAGE_VERSIONS = {
    "collect": 3,
    "ensemble": 2,
    "tune": 2,
    "train": 2,
    "validate": 1,
    "evaluate": 2,
    "record": 7,
    "record_data": 4,
}


class Pipeline:
    """The tasks of a study.

    Raises:
        BadInput: an environment or a model is unknown, or a model names no section `train`.
    """

    def __init__(self, config: Config) -> None:
        self.config = config
        for environment in config.grid.environments:
            simulators[environment]
        for model in config.grid.models:
            if "train" not in models[model].sections:
                raise BadInput(f"model {model}: its `sections` need 'train', how it is fitted")

    def collect(self, environment: str) -> Task:
        """The data of one environment, shared by all its cells."""
        settings = {
            "environment": environment,
            "environment_version": simulators[environment].version,
            "collect": asdict(self.config.collect),
        }
        return self._task("collect", environment, settings)

    def ensemble(self, cell: Cell) -> Task:
        """The M networks of one environment, level and seed."""
        label = f"{cell.environment}/{cell.level}/seed-{cell.seed}"
        settings = self._training_set(cell) | {
            "seed": derive(label, "ensemble"),
            "ensemble": asdict(self.config.ensemble),
        }
        return self._task("ensemble", label, settings, data=self.collect(cell.environment))

    def tune(self, cell: Cell) -> Task:
        """The search for β of one cell."""
        settings = self._model(cell, "tune") | {"tune": asdict(self.config.tune)}
        return self._task("tune", cell.name, settings, **self._sources(cell))

    def train(self, cell: Cell) -> Task:
        """The fit of one cell's model."""
        inputs = self._sources(cell)
        if models[cell.model].tunes_beta:
            inputs["tuning"] = self.tune(cell)
        return self._task("train", cell.name, self._model(cell, "train"), **inputs)

    def validate(self, cell: Cell) -> Task:
        """Scores of one cell's model on validation scenarios, for `ablate`."""
        settings = {
            "environment": cell.environment,
            "environment_version": simulators[cell.environment].version,
            "seed": derive(cell.environment, cell.seed, "validation forecasts"),
            "samples": self.config.evaluate.samples,
        }
        inputs = {"data": self.collect(cell.environment), "trained": self.train(cell)}
        return self._task("validate", cell.name, settings, **inputs)

    def evaluate(self, cell: Cell) -> Task:
        """Forecasts of the test scenarios and their scores."""
        settings = {
            "environment": cell.environment,
            "environment_version": simulators[cell.environment].version,
            "model": cell.model,
            # The oracle is the same at both levels; its folder is then the same, too.
            "seed": derive(cell.environment, cell.model, cell.seed, "forecasts"),
            "evaluate": asdict(self.config.evaluate),
        }
        inputs = {"data": self.collect(cell.environment)}
        if cell.model == "ensemble":
            inputs["ensemble"] = self.ensemble(cell)
        elif not cell.is_reference:
            inputs["trained"] = self.train(cell)
            if models[cell.model].uses_ensemble:
                inputs["ensemble"] = self.ensemble(cell)
        label = f"{cell.environment}/oracle" if cell.model == "oracle" else cell.name
        return self._task("evaluate", label, settings, **inputs)

    def record_data(self, environment: str) -> Task:
        """The Rerun recording of one environment's training data."""
        settings = {"environment": environment}
        return self._task("record_data", environment, settings, data=self.collect(environment))

    def record(self, cell: Cell) -> Task:
        """The cell's Rerun recordings; those of its data are published with them."""
        inputs = {
            "data": self.collect(cell.environment),
            "data_recording": self.record_data(cell.environment),
            "evaluation": self.evaluate(cell),
        }
        if cell.model == "ensemble":
            inputs["ensemble"] = self.ensemble(cell)
        elif not cell.is_reference:
            inputs["trained"] = self.train(cell)
            if models[cell.model].tunes_beta:
                inputs["tuning"] = self.tune(cell)
        return self._task("record", cell.name, asdict(cell), **inputs)

    def _training_set(self, cell: Cell) -> dict[str, Any]:
        """Which trajectories: all, or (level high) the seed's own tenth of them."""
        collect = self.config.collect
        if cell.level == "low":
            return {"first": 0, "trajectories": collect.trajectories}
        count = collect.trajectories // collect.reduction
        return {"first": cell.seed % collect.reduction * count, "trajectories": count}

    def _model(self, cell: Cell, purpose: str) -> dict[str, Any]:
        model = models[cell.model]
        config = asdict(self.config)
        sections = {name: config[name] for name in model.sections}
        sections["train"] = model.budget(sections)
        return self._training_set(cell) | {
            "model": cell.model,
            "model_version": model.version,
            "seed": derive(cell.name, purpose),
            "sections": sections,
        }

    def _sources(self, cell: Cell) -> dict[str, Task]:
        sources = {"data": self.collect(cell.environment)}
        if models[cell.model].uses_ensemble:
            sources["ensemble"] = self.ensemble(cell)
        return sources

    def _task(self, stage: str, label: str, settings: dict[str, Any], **inputs: Task) -> Task:
        settings = settings | {"stage_version": STAGE_VERSIONS[stage]}
        return Task(stage, label, settings, inputs, self.config.plugins)
