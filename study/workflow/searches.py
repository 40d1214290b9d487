"""The searches of a study in one database: see the setting `tune.storage`."""

from collections.abc import Iterable
from dataclasses import replace

from study.config.settings import Config
from study.workflow.task import Task


def with_database(tasks: Iterable[Task], config: Config) -> list[Task]:
    """The tasks, of which those of searches know the database and the name of their search.

    The tables are created here, since workers that start together would create them together. The
    name has the key of the task `tune` or `select`, so a change of what the search depends on is
    another search.

    Raises:
        BadInput: the database cannot be used.
    """
    tasks, url = list(tasks), config.tune.storage
    names = _names(tasks, config)
    if url is None or not names:
        return tasks
    from study.training.search_storage import database  # Optuna takes a second to import

    database(url)
    return [
        replace(task, services={"database": {"url": url, "search": names[task]}})
        if task in names
        else task
        for task in tasks
    ]


def _names(tasks: Iterable[Task], config: Config) -> dict[Task, str]:
    """The name of the search of each task of a search."""
    names = {}
    for task in tasks:
        if task.stage in ("tune", "select"):
            names[task] = f"{config.name}/{task.label} {task.key[:16]}"
        if task.stage == "select":
            names |= dict.fromkeys(task.inputs.values(), names[task])
    return names
