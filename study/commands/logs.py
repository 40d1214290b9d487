"""The logs of recorded systems are read before a run writes anything, so that errors come first."""

from collections.abc import Iterable

from rich.console import Console

from study.commands.terminal import say
from study.common.counts import counted
from study.config.recorded import recorded_of
from study.config.settings import Config
from study.workflow.store import Store
from study.workflow.task import Task


def check_logs(config: Config, tasks: Iterable[Task], store: Store, terminal: Console) -> None:
    """Read the logs of which a stage collect is due, and print what they hold.

    Raises:
        BadInput: names the file, the column and the row; or there are too few windows.
    """
    for task in tasks:
        recorded = recorded_of(config, task.label) if task.stage == "collect" else None
        if recorded is None or store.reason_to_run(task) is None:
            continue
        from study.common.progress import Progress
        from study.data.recorded.description import Description
        from study.data.recorded.windows import warnings_of
        from study.envs.recorded import windows_of

        split = windows_of(task.label, recorded, config.collect, Progress())
        parts = ", ".join(
            f"{side} {counted(len(windows), 'window')} of "
            f"{counted(len(windows.trajectories), 'trajectory')}"
            for side, windows in split.windows.items()
        )
        logs, rows = counted(len(split.files), "log"), counted(split.rows, "row")
        say(terminal, f"{task.label}: {logs}, {rows}; {parts}")
        for warning in warnings_of(Description(task.label, recorded), split):
            say(terminal, f"warning: {warning}")
