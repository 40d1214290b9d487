"""The searches of a study in one database: see the setting `tune.storage`."""

from collections.abc import Iterable
from dataclasses import replace

from study.config.settings import Config
from study.workflow.task import Task


def with_database(tasks: Iterable[Task], config: Config) -> list[Task]:
    """The tasks, of which those of the stage tune know the database and their name in it.

    The tables are created here, since workers that start together would create them together. The
    name has the task's key, so a change of what the search depends on is another search.

    Raises:
        BadInput: the database cannot be used.
    """
    tasks, url = list(tasks), config.tune.storage
    if url is None or all(task.stage != "tune" for task in tasks):
        return tasks
    from study.training.search_storage import database  # Optuna takes a second to import

    database(url)
    return [
        replace(task, services={"database": {"url": url, "search": _name(task, config)}})
        if task.stage == "tune"
        else task
        for task in tasks
    ]


def _name(task: Task, config: Config) -> str:
    return f"{config.name}/{task.label} {task.key[:16]}"
