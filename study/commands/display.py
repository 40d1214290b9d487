"""The progress of a run: bars in a terminal, otherwise plain lines."""

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from statistics import fmean
from types import TracebackType

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from study.commands.terminal import say
from study.common.progress import read_progress
from study.config.settings import Engine
from study.workflow.engine import start, terms
from study.workflow.scheduler import run_tasks
from study.workflow.store import Store
from study.workflow.task import Task
from study.workflow.worker import Outcome

EXPECTED = {
    "collect": 44.0,
    "ensemble": 105.0,
    "tune": 96.0,
    "trial": 24.0,
    "select": 0.3,
    "train": 77.0,
    "evaluate": 22.0,
    "record": 3.0,
    "record_data": 0.3,
}
"""Seconds of each stage, between those of quick.yaml and paper.yaml. The remaining time is
estimated from these until stages of the run have ended."""
INTERVAL = 60.0
"""Seconds between two lines about running stages, if the output is not a terminal."""


def run_displayed(
    tasks: list[Task], engine: Engine, store: Store, console: Console
) -> dict[Task, str]:
    """Run tasks and show their progress.

    Returns:
        the error of every task that failed or was not run.
    """
    store = Store(store.root.resolve())  # workers of a cluster have other working folders
    with Display(tasks, store, console) as display, start(engine, store.root, tasks) as workers:
        errors = run_tasks(
            tasks,
            store,
            workers,
            engine.threads,
            display.started,
            display.finished,
            terms(engine),
            display.lost,
        )
    for task in tasks:
        if task not in errors:
            store.is_visible(task)  # a file server may show folders of other machines late
    return errors


class Display:
    """Shows the tasks of a run.

    Args:
        tasks: all tasks of the run.
        store: holds the progress files and logs of the tasks.
        console: the terminal.
    """

    def __init__(self, tasks: list[Task], store: Store, console: Console) -> None:
        self.tasks, self.store, self.console = tasks, store, console
        self.ended: dict[Task, float] = {}
        self.began = time.monotonic()
        self._stop = threading.Event()
        self._lock = threading.Lock()
        self._bars: dict[Task, TaskID] = {}
        self._live = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=30),
            TextColumn("{task.percentage:>3.0f}%"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[note]}"),
            console=console,
            disable=not console.is_terminal,
            transient=True,
        )
        self._thread = threading.Thread(target=self._follow, daemon=True)

    def __enter__(self) -> "Display":
        self._total = self._live.add_task("study", total=1.0, note="")
        self._live.start()
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop.set()
        self._thread.join()
        self._live.stop()

    def started(self, task: Task) -> None:
        """Show a task that has started."""
        with self._lock:
            self._bars[task] = self._live.add_task(f"  {task.name}", total=1.0, note="")

    def lost(self, task: Task, why: str) -> None:
        """Tell that a task starts again, since its worker was lost."""
        with self._lock:
            if task in self._bars:
                self._live.remove_task(self._bars.pop(task))
        say(self.console, f"{task.name}: the worker was lost ({why}); the stage starts again")

    def finished(self, outcome: Outcome) -> None:
        """Show the outcome of a task in one line."""
        with self._lock:
            self.ended[outcome.task] = outcome.seconds
            if outcome.task in self._bars:
                self._live.remove_task(self._bars.pop(outcome.task))
        count = f"[{len(self.ended)}/{len(self.tasks)}]"
        name = f"{outcome.task.stage:11} {outcome.task.label}"
        if outcome.error is None:
            say(self.console, f"{count} {name}  {outcome.seconds:.1f} s")
        else:
            say(self.console, f"{count} {name}  FAILED: {outcome.error}")
            if outcome.seconds:
                say(self.console, f"        its log: {self.store.log(outcome.task)}")

    def _follow(self) -> None:
        last_line = time.monotonic()
        while not self._stop.wait(0.5):
            with self._lock:
                shares = {task: self._share(task) for task in self._bars}
                for task, (fraction, message) in shares.items():
                    self._live.update(self._bars[task], completed=fraction, note=escape(message))
            fraction, rest = self._estimate({task: share for task, (share, _) in shares.items()})
            note = f"about {_words(rest)} left" if rest is not None else ""
            self._live.update(self._total, completed=fraction, note=note)
            if not self.console.is_terminal and time.monotonic() - last_line > INTERVAL:
                last_line = time.monotonic()
                running = ", ".join(f"{t.name} {s:.0%}" for t, (s, _) in shares.items())
                with suppress(BrokenPipeError):  # the next line of the main thread raises it too
                    say(self.console, f"  … {fraction:.0%} {note}: {running}")

    def _share(self, task: Task) -> tuple[float, str]:
        state = read_progress(self.store.progress(task))
        return float(state.get("fraction", 0.0)), str(state.get("message", ""))

    def _estimate(self, shares: dict[Task, float]) -> tuple[float, float | None]:
        """The completed fraction of the run, and the remaining seconds; None while unknown."""
        expected = expectations(self.ended)
        weights = {task: self.ended.get(task) or expected(task.stage) for task in self.tasks}
        total = sum(weights.values())
        completed = sum(weights[task] for task in self.ended)
        completed += sum(weights[task] * share for task, share in shares.items())
        elapsed = time.monotonic() - self.began
        if elapsed < 3 or completed <= 0.01 * total:
            return completed / total, None
        return completed / total, elapsed * (total - completed) / completed


def expectations(ended: Mapping[Task, float]) -> Callable[[str], float]:
    """The expected duration of a stage, from the tasks that have ended.

    Args:
        ended: seconds of each task that has ended; 0 for a task that was not run.

    Returns:
        a function from a stage to seconds. This is the mean of the stage's ended tasks. Without
        ended tasks it is `EXPECTED` times the ratio of actual to expected time of all ended tasks.
    """
    measured = {task: seconds for task, seconds in ended.items() if seconds}
    by_stage: dict[str, list[float]] = {}
    for task, seconds in measured.items():
        by_stage.setdefault(task.stage, []).append(seconds)
    total = sum(EXPECTED.get(task.stage, 1.0) for task in measured)
    ratio = sum(measured.values()) / total if total else 1.0

    def expected(stage: str) -> float:
        seconds = by_stage.get(stage)
        return fmean(seconds) if seconds else ratio * EXPECTED.get(stage, 1.0)

    return expected


def _words(seconds: float) -> str:
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
