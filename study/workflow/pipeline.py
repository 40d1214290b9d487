"""The stages that a cell needs, and their dependencies.

    collect ─► ensemble ─► tune β ─► train ─► evaluate ─► record
       └─► record_data ────────────────────────────────────►┘

With `tune.batch`, a task `trial` for each trial and the task `select` replace `tune`.

A task depends on its settings, on its input tasks, and on the source of its stage, environment and
model. It depends on nothing else. Data or an ensemble that several cells share is one task. Within
`study.workflow`, only this module uses the registries of environments and models.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from study.common.seeds import derive
from study.config.convert import to_json
from study.config.grid import Cell
from study.config.names import ENSEMBLE, FROM_DATA
from study.config.recorded import Recorded, recorded_of
from study.config.settings import Config
from study.config.stage_settings import (
    CollectSettings,
    EnsembleSettings,
    EvaluateSettings,
    RecordDataSettings,
    RecordSettings,
    SelectSettings,
    TrainingSet,
    TrainSettings,
    TrialSettings,
    TuneSettings,
    ValidateSettings,
)
from study.envs import Simulator, simulators
from study.envs.recorded import check, log_digests
from study.models import models
from study.workflow.source import source_digests
from study.workflow.task import Task


class Pipeline:
    """The tasks of a study.

    Raises:
        BadInput: an environment or a model of the grid is unknown.
    """

    def __init__(self, config: Config) -> None:
        self.config = config
        self._searches: dict[Cell, Task] = {}
        for environment in config.grid.environments:
            self._system(environment)
        for model in config.grid.models:
            models[model]

    def collect(self, environment: str) -> Task:
        """The data of one environment, shared by all its cells."""
        recorded = self._recorded(environment)
        if recorded is None:
            settings = CollectSettings(environment, self.config.collect)
        else:
            files = log_digests(environment, recorded)
            settings = CollectSettings(environment, self.config.collect, recorded.of_data(), files)
        return self._task("collect", environment, settings, [self._system(environment)])

    def ensemble(self, cell: Cell) -> Task:
        """The M recurrent networks of one environment, level and seed."""
        label = f"{cell.environment}/{cell.level}/seed-{cell.seed}"
        settings = EnsembleSettings(
            self._training_set(cell),
            derive(label, "ensemble"),
            self.config.ensemble,
            self.config.section("network"),
            self.config.train.accelerator,
            self.config.train.precision,
        )
        return self._task("ensemble", label, settings, data=self.collect(cell.environment))

    def tune(self, cell: Cell) -> Task:
        """The search for β of one cell: one task, or the last one of a search in batches."""
        if cell not in self._searches:
            settings = TuneSettings(self._fit(cell, "tune"), self.config.tune)
            self._searches[cell] = self._search(cell, settings)
        return self._searches[cell]

    def train(self, cell: Cell) -> Task:
        """The fit of one cell's model."""
        inputs = self._sources(cell)
        if models[cell.model].tunes_beta:
            inputs["tuning"] = self.tune(cell)
        settings = self._fit(cell, "train")
        return self._task("train", cell.name, settings, [models[cell.model]], **inputs)

    def validate(self, cell: Cell) -> Task:
        """Scores of one cell's model on validation scenarios, for `ablate`."""
        settings = ValidateSettings(
            cell.environment,
            derive(cell.environment, cell.seed, "validation forecasts"),
            self.config.evaluate.samples,
            self._recorded(cell.environment),
            self.config.train.accelerator,
        )
        inputs = {"data": self.collect(cell.environment), "trained": self.train(cell)}
        classes = [self._system(cell.environment), models[cell.model]]
        return self._task("validate", cell.name, settings, classes, **inputs)

    def evaluate(self, cell: Cell) -> Task:
        """Forecasts of the test scenarios and their scores.

        Label and seed of the oracle do not contain the level, so all levels share one task.
        """
        settings = self.evaluate_settings(cell)
        inputs = {"data": self.collect(cell.environment), **self._fitted(cell)}
        classes: list[type] = [self._system(cell.environment)]
        if "trained" in inputs:
            classes.append(models[cell.model])
        return self._task("evaluate", cell.evaluation, settings, classes, **inputs)

    def evaluate_settings(self, cell: Cell) -> EvaluateSettings:
        """The settings of `evaluate`, which need no log of a recorded system."""
        has_network = cell.model == ENSEMBLE or not cell.is_reference
        return EvaluateSettings(
            cell.environment,
            cell.model,
            derive(cell.environment, cell.model, cell.seed, "forecasts"),
            self.config.evaluate,
            self._recorded(cell.environment),
            self._training_set(cell) if cell.model in FROM_DATA else None,
            self.config.train.accelerator if has_network else "auto",
        )

    def record_data(self, environment: str) -> Task:
        """The Rerun recording of one environment's training data."""
        settings = RecordDataSettings(environment, self._recorded(environment))
        classes, data = [self._system(environment)], self.collect(environment)
        return self._task("record_data", environment, settings, classes, data=data)

    def record(self, cell: Cell) -> Task:
        """The cell's Rerun recordings. The recording of its data is published with them."""
        inputs = {
            "data": self.collect(cell.environment),
            "data_recording": self.record_data(cell.environment),
            "evaluation": self.evaluate(cell),
            **self._fitted(cell),
        }
        if "trained" in inputs and models[cell.model].tunes_beta:
            inputs["tuning"] = self.tune(cell)
        recorded = self._recorded(cell.environment)
        settings = RecordSettings(cell.environment, cell.level, cell.model, cell.seed, recorded)
        classes = [self._system(cell.environment)]
        return self._task("record", cell.name, settings, classes, **inputs)

    def _fitted(self, cell: Cell) -> dict[str, Task]:
        """The task whose weights make the cell's forecasts, by the name of the input."""
        if cell.model == ENSEMBLE:
            return {"ensemble": self.ensemble(cell)}
        return {} if cell.is_reference else {"trained": self.train(cell)}

    def _recorded(self, environment: str) -> Recorded | None:
        return recorded_of(self.config, environment)

    def _system(self, environment: str) -> type[Simulator]:
        """The class of the environment.

        Raises:
            BadInput: it is unknown, or a setting of a recorded system cannot be used.
        """
        recorded = self._recorded(environment)
        return simulators[environment] if recorded is None else check(environment, recorded)

    def _training_set(self, cell: Cell) -> TrainingSet:
        """The seed's part of the trajectories, as the fraction of its level says."""
        fraction, total = self.config.grid.levels[cell.level], self.config.collect.trajectories
        if self._recorded(cell.environment) is not None:
            return TrainingSet.of_recorded(fraction, cell.seed)
        return TrainingSet.of_level(fraction, total, cell.seed)

    def _fit(self, cell: Cell, purpose: str) -> TrainSettings:
        """The fit of the cell's model, with `Model.training_options`."""
        model = models[cell.model]
        settings = model.settings_from(self.config, cell.model)
        settings = replace(settings, train=model.training_options(settings))
        seed = derive(cell.name, purpose)
        return TrainSettings(self._training_set(cell), cell.model, to_json(settings), seed)

    def _search(self, cell: Cell, settings: TuneSettings) -> Task:
        """The task `tune`, or `select` after a task `trial` for each trial."""
        tune, classes, sources = settings.tune, [models[cell.model]], self._sources(cell)
        if tune.batch == 1:
            return self._task("tune", cell.name, settings, classes, **sources)
        trials: dict[str, Task] = {}
        for first in range(0, tune.trials, tune.batch):
            inputs = sources | trials
            for number in range(first, min(first + tune.batch, tune.trials)):
                name = f"trial-{number}"
                of_trial = TrialSettings(settings.fit, tune, number=number)
                trials[name] = self._task(
                    "trial", f"{cell.name}/{name}", of_trial, classes, **inputs
                )
        selection = SelectSettings(settings.fit.model, tune)
        return self._task("select", cell.name, selection, (), **trials)

    def _sources(self, cell: Cell) -> dict[str, Task]:
        sources = {"data": self.collect(cell.environment)}
        if models[cell.model].uses_ensemble:
            sources["ensemble"] = self.ensemble(cell)
        return sources

    def _task(
        self, stage: str, label: str, settings: Any, classes: Sequence[type] = (), **inputs: Task
    ) -> Task:
        """A task that depends on the source of its stage and of registered classes."""
        modules = (registered.__module__ for registered in classes)
        source = source_digests((f"study.stages.{stage}", *modules))
        return Task(stage, label, to_json(settings), inputs, source, self.config.plugins)
