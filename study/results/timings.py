"""``timings.json``: the cost of each stage of a study.

Timings differ between runs, so they are not in ``study.json``.
"""

import platform
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from study.common.files import read_json, write_json
from study.config.names import ORACLE
from study.config.settings import Config
from study.workflow.engine import workers
from study.workflow.store import Store
from study.workflow.task import Task

NAME = "timings.json"
PER_STAGE = {"seconds": 3, "cpu_seconds": 3, "peak_memory": 0}
"""The quantities of each stage, and the decimals to which they are rounded."""
DEVICE = "device"
"""The entry with the device of each fit and of each forecast, such as `cpu` or `cuda`."""


def write(tasks: Iterable[Task], store: Store, config: Config, out: Path) -> None:
    """Write the cost of each task, and the engine that ran the tasks.

    Wall time and CPU time are in seconds, and peak memory in bytes. A quantity that was not
    measured is left out. Tasks that fit or forecast also have a device.
    """
    costs = {task.name: store.timing(task) for task in tasks}
    measured = {
        quantity: {
            name: round(cost[quantity], digits or None)
            for name, cost in costs.items()
            if quantity in cost
        }
        for quantity, digits in PER_STAGE.items()
    }
    devices = {name: cost[DEVICE] for name, cost in costs.items() if DEVICE in cost}
    facts = {
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": f"{platform.system()} {platform.machine()}",
        "engine": asdict(config.engine),
        "workers": workers(config.engine),
    }
    write_json(out / NAME, facts | measured | {DEVICE: devices})


def read(out: Path) -> dict[str, dict[str, Any]]:
    """The published cost of each task, by its name; empty if there is none."""
    costs: dict[str, dict[str, Any]] = {}
    try:
        facts = read_json(out / NAME)
        for quantity in PER_STAGE:
            for task, value in facts[quantity].items():
                costs.setdefault(task, {})[quantity] = float(value)
        for task, device in facts.get(DEVICE, {}).items():
            costs.setdefault(task, {})[DEVICE] = str(device)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
    return costs


def join(folders: Iterable[Path], out: Path) -> None:
    """Write the timings of several studies as those of one study."""
    parts = [read_json(folder / NAME) for folder in folders]
    merged = {
        quantity: {name: value for part in parts for name, value in part.get(quantity, {}).items()}
        for quantity in (*PER_STAGE, DEVICE)
    }
    finished = max(part["finished"] for part in parts)
    write_json(out / NAME, parts[0] | {"finished": finished} | merged)


def parallel_tasks(config: Config, out: Path) -> int:
    """The number of parallel tasks of the run that published the results."""
    try:
        return int(read_json(out / NAME)["workers"])
    except (OSError, ValueError, KeyError, TypeError):
        return workers(config.engine)


def of(task: Task, costs: Mapping[str, Mapping[str, Any]]) -> Mapping[str, Any]:
    """The published cost of a task, empty if there is none.

    Args:
        task: the task.
        costs: see `read`. In earlier versions the name of the oracle was without the seed.
    """
    earlier = re.sub(rf"/{ORACLE}/seed-\d+$", f"/{ORACLE}", task.name)
    return costs.get(task.name) or costs.get(earlier, {})
