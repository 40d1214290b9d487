"""Which task makes each cell, remembered: to find it out, every model is imported.

That means torch and Lightning, seconds of work. A run leaves its tasks in ``work/tasks.json``, and
as long as the settings and the source are the same, `plan`, `status` and an `all` that finds
nothing to do read them there.
"""

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from study.common.files import digest, read_json, write_json
from study.common.provenance import source_revision
from study.config.grid import Cell, cells
from study.config.settings import Config
from study.workflow.store import Store, Task


def record_tasks(config: Config, store: Store) -> dict[Cell, Task]:
    """The last task of every cell of the grid; all that it depends on hangs on it.

    Raises:
        BadInput: an environment or a model is unknown.
    """
    try:
        known = read_json(_path(store))
        content = known["content"]
        if known["key"] == _key(config) and known["sha256"] == digest(content):
            tasks = _unpack(content["tasks"], config.plugins)
            return {cell: tasks[content["cells"][cell.name]] for cell in cells(config)}
    except (OSError, ValueError, KeyError, TypeError, IndexError):
        pass  # none, or damaged: found out again
    from study.workflow.pipeline import Pipeline

    pipeline = Pipeline(config)
    return {cell: pipeline.record(cell) for cell in cells(config)}


def remember(config: Config, records: Mapping[Cell, Task], store: Store) -> None:
    """Keep what `record_tasks` found out."""
    if config.plugins:
        return  # they import what they like: there is nothing to save, and their source may change
    ordered = line_up(records.values())
    number = {task: index for index, task in enumerate(ordered)}
    content = {
        "cells": {cell.name: number[task] for cell, task in records.items()},
        "tasks": [_pack(task, number) for task in ordered],
    }
    write_json(_path(store), {"key": _key(config), "sha256": digest(content), "content": content})


def line_up(last: Iterable[Task]) -> list[Task]:
    """The tasks `last` and all that they depend on, each once, a task after all that it reads."""
    ordered: dict[Task, None] = {}

    def visit(task: Task) -> None:
        for source in task.inputs.values():
            visit(source)
        ordered.setdefault(task)

    for task in last:
        visit(task)
    return list(ordered)


def _path(store: Store) -> Path:
    return store.root / "tasks.json"


def _key(config: Config) -> str:
    """Of all that the tasks depend on: the settings, and the source, which has the versions."""
    return digest([asdict(config), source_revision()])


def _pack(task: Task, number: dict[Task, int]) -> dict[str, Any]:
    return {
        "stage": task.stage,
        "label": task.label,
        "settings": dict(task.settings),
        "inputs": {name: number[source] for name, source in task.inputs.items()},
    }


def _unpack(packed: list[dict[str, Any]], plugins: tuple[str, ...]) -> list[Task]:
    tasks: list[Task] = []
    for entry in packed:
        inputs = {name: tasks[index] for name, index in entry["inputs"].items()}
        tasks.append(Task(entry["stage"], entry["label"], entry["settings"], inputs, plugins))
    return tasks
