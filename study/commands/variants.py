"""Run cells with several settings in one store, where stages with equal settings are shared.

`ablate` and `multiverse` use it. An ablation is a multiverse with one base reading that is changed
one setting at a time, and is scored on validation data.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING

from rich.console import Console

from study.commands.run_all import run_due
from study.config.grid import Cell, cells, select
from study.config.settings import Config
from study.workflow.searches import with_database
from study.workflow.store import Store
from study.workflow.task import Task
from study.workflow.task_cache import topological_order

if TYPE_CHECKING:
    from study.workflow.pipeline import Pipeline

Variants = Mapping[str, Mapping[Cell, Task]]
"""The last task of every cell, by the name of the settings."""


def last_tasks(
    configs: Mapping[str, Config],
    only: str | None,
    last: Callable[["Pipeline", Cell], Task],
    references: bool,
) -> Variants:
    """The last task of every cell whose name matches `only`, for each of several settings.

    Args:
        configs: the settings by name.
        only: a pattern of cells' names; None for all cells.
        last: a method of `Pipeline`, such as `Pipeline.validate`.
        references: whether the oracle and the ensemble alone are included.
    """
    from study.workflow.pipeline import Pipeline

    variants = {}
    for name, config in configs.items():
        pipeline = Pipeline(config)
        selected = select(cells(config), only)
        variants[name] = {
            cell: last(pipeline, cell) for cell in selected if references or not cell.is_reference
        }
    return variants


def tasks_of(variants: Variants) -> list[Task]:
    """The tasks of all variants without repetition, every task after its inputs."""
    return topological_order(task for by_cell in variants.values() for task in by_cell.values())


def run_missing(
    tasks: Iterable[Task], config: Config, store: Store, terminal: Console
) -> dict[Task, str]:
    """Run the tasks that are not up to date. The caller has locked the results folder.

    Returns:
        the error of every task that failed or was not run.
    """
    store.remove_leftovers()
    due = [task for task in tasks if store.reason_to_run(task) is not None]
    ready = with_database(due, config)
    return run_due(ready, config.engine, store, terminal) if ready else {}
