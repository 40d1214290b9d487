"""Which data are used where: high is a part of low, and only scores use the test set."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from study.common.files import read_json
from study.common.provenance import MANIFEST
from study.config.convert import from_json
from study.config.grid import Cell
from study.config.settings import Config, Grid
from study.config.stage_settings import TrainingSet
from study.data.trajectories import ScenarioSet, Trajectories
from study.training.inputs import training_data
from study.workflow.pipeline import Pipeline
from study.workflow.store import Store
from study.workflow.task import Task
from study.workflow.task_cache import record_tasks, topological_order
from study.workflow.worker import execute
from tests.helpers.running import SMALL, SMOKE, Done, configuration


def _rows(states: np.ndarray) -> set[bytes]:
    return {np.ascontiguousarray(row).tobytes() for row in states}


@pytest.mark.parametrize("environment", ["pusher", "uav"])
def test_scenarios_of_training_validation_and_test_differ(
    smoke: tuple[Path, Done], environment: str
) -> None:
    config = configuration(*SMOKE)
    data = Store(smoke[0] / "work").folder(Pipeline(config).collect(environment))
    train = Trajectories.load(data / "train.safetensors")
    validation = ScenarioSet.load(data / "validation.safetensors")
    test = ScenarioSet.load(data / "test.safetensors")
    assert len({set_.facts["seed"] for set_ in (train, validation, test)}) == 3
    first = [_rows(train.states[:, 0]), _rows(validation.s0), _rows(test.s0)]
    collect = config.collect
    assert [len(f) for f in first] == [collect.trajectories, collect.validation, collect.scenarios]
    assert len(set.union(*first)) == sum(map(len, first))
    planned = [_rows(train.actions), _rows(validation.actions), _rows(test.actions)]
    assert len(set.union(*planned)) == sum(map(len, planned))


def test_level_high_is_a_part_of_low(smoke: tuple[Path, Done]) -> None:
    config = configuration(*SMOKE, "--grid.seeds", "[0, 1, 2]")
    pipeline = Pipeline(config)
    data = Store(smoke[0] / "work").folder(pipeline.collect("pusher"))

    def training(level: str, seed: int, model: str) -> set[bytes]:
        cell = Cell("pusher", level, model, seed)
        task = pipeline.ensemble(cell) if model == "ensemble" else pipeline.train(cell)
        return _rows(
            training_data(from_json(TrainingSet, task.settings["training"]), data).training.states
        )

    tenths = []
    for seed in config.grid.seeds:
        low, high = training("low", seed, "ensemble"), training("high", seed, "ensemble")
        assert high < low
        assert len(high) * 10 == len(low)
        for model in config.grid.models:  # a cell's model learns from what its ensemble does
            assert training("low", seed, model) == low
            assert training("high", seed, model) == high
        tenths.append(high)
    assert not set.intersection(*tenths)


def test_every_level_and_seed_is_scored_on_the_same_test_set() -> None:
    pipeline = Pipeline(Config(grid=Grid(seeds=(0, 1))))
    for environment in ("pusher", "uav"):
        data = {
            pipeline.evaluate(Cell(environment, level, model, seed)).inputs["data"].key
            for level in ("low", "high")
            for model in ("residual_vae", "probabilistic_mlp", "oracle", "ensemble")
            for seed in (0, 1)
        }
        assert len(data) == 1


def _copy_without_test(small: Path, tmp_path: Path, tasks: list[Task]) -> Store:
    store = Store(tmp_path / "work")
    for task in tasks:
        if task.stage == "collect":
            source = Store(small / "work").folder(task)
            shutil.copytree(source, store.folder(task))
            (store.folder(task) / "test.safetensors").unlink()
    return store


def test_stages_that_fit_never_open_the_test_set(small: Path, tmp_path: Path) -> None:
    uninterrupted = Store(small / "work")
    config = configuration(*SMALL)
    tasks = topological_order(record_tasks(config, uninterrupted).values())
    store = _copy_without_test(small, tmp_path, tasks)
    learning = [task for task in tasks if task.stage in ("ensemble", "tune", "train")]
    assert len(learning) == 4
    for task in learning:
        assert execute(task, store.root, 1).error is None
        stores = (store, uninterrupted)
        found, expected = (read_json(s.folder(task) / MANIFEST)["files"] for s in stores)
        for name in ("ensemble.safetensors", "tuning.json", "model.safetensors", "fit.json"):
            assert found.get(name) == expected.get(name)
    scored = next(task for task in tasks if task.stage == "evaluate")
    assert "test.safetensors" in str(execute(scored, store.root, 1).error)
