"""A cache of the tasks of a study, so that `plan` and `status` answer immediately.

`study.workflow.pipeline` imports every model, and with them torch and Lightning, which takes
seconds. So a run writes its tasks to ``work/tasks.json``. The tasks are read from this file while
the settings and the source are the same.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from study.common.files import digest, read_json, write_json
from study.common.provenance import source_revision
from study.config.grid import Cell, cells
from study.config.recorded import recorded_of
from study.config.settings import Config
from study.config.tree import to_json
from study.workflow.store import Store
from study.workflow.task import Task


def record_tasks(config: Config, store: Store) -> dict[Cell, Task]:
    """The last task, `record`, of every cell of the grid. All other tasks are inputs of these.

    Raises:
        BadInput: an environment or a model is unknown.
    """
    try:
        cached = read_json(_path(store))
        content = cached["content"]
        if cached["key"] == _key(config) and cached["sha256"] == digest(content):
            tasks = _unpack(content["tasks"], config.plugins)
            return {cell: tasks[content["cells"][cell.name]] for cell in cells(config)}
    except (OSError, ValueError, KeyError, TypeError, IndexError):
        pass  # no cache, or a damaged one
    from study.workflow.pipeline import Pipeline

    pipeline = Pipeline(config)
    return {cell: pipeline.record(cell) for cell in cells(config)}


def write_cache(config: Config, records: Mapping[Cell, Task], store: Store) -> None:
    """Write the tasks of `record_tasks` to the cache.

    A study with plugins has no cache. The source of a plugin may change, and its import takes as
    long as that of the models. Neither has a study of logs, which may change.
    """
    if config.plugins or any(recorded_of(config, name) for name in config.grid.environments):
        return
    ordered = topological_order(records.values())
    number = {task: index for index, task in enumerate(ordered)}
    content = {
        "cells": {cell.name: number[task] for cell, task in records.items()},
        "tasks": [_pack(task, number) for task in ordered],
    }
    write_json(_path(store), {"key": _key(config), "sha256": digest(content), "content": content})


def topological_order(last: Iterable[Task]) -> list[Task]:
    """The tasks `last` and all their inputs without repetition, every task after its inputs."""
    ordered: dict[Task, None] = {}

    def visit(task: Task) -> None:
        if task in ordered:
            return
        for source in task.inputs.values():
            visit(source)
        ordered.setdefault(task)

    for task in last:
        visit(task)
    return list(ordered)


def _path(store: Store) -> Path:
    return store.root / "tasks.json"


def _key(config: Config) -> str:
    """Hash of all that the tasks depend on: the settings, and the source with its versions."""
    return digest([to_json(config), source_revision()])


def _pack(task: Task, number: Mapping[Task, int]) -> dict[str, Any]:
    return {
        "stage": task.stage,
        "label": task.label,
        "settings": dict(task.settings),
        "inputs": {name: number[source] for name, source in task.inputs.items()},
        "source": dict(task.source),
    }


def _unpack(packed: Iterable[Mapping[str, Any]], plugins: tuple[str, ...]) -> list[Task]:
    tasks: list[Task] = []
    for entry in packed:
        inputs = {name: tasks[index] for name, index in entry["inputs"].items()}
        tasks.append(Task(**{**entry, "inputs": inputs, "plugins": plugins}))
    return tasks
