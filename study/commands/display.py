"""What the user sees while the study runs: a live bar in a terminal, plain lines elsewhere."""

import threading
import time
from collections.abc import Callable, Mapping
from statistics import fmean
from types import TracebackType

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from study.common.progress import Progress as Told
from study.common.progress import read_progress
from study.workflow.store import Store, Task
from study.workflow.worker import Outcome

# Seconds of a stage between quick.yaml's and paper.yaml's, until stages of this run have ended.
EXPECTED = {
    "collect": 44.0,
    "ensemble": 105.0,
    "tune": 96.0,
    "train": 77.0,
    "evaluate": 22.0,
    "record": 3.0,
    "record_data": 0.3,
}
# Without a terminal, a long stage is heard of this often.
HEARTBEAT = 60.0


class Display:
    """Follows the tasks of a run.

    Args:
        tasks: those that will run.
        store: where their progress is read.
        console: where to write.
        workers: how many run side by side.
    """

    def __init__(self, tasks: list[Task], store: Store, console: Console, workers: int) -> None:
        self.tasks, self.store, self.console, self.workers = tasks, store, console, workers
        self.running: dict[Task, float] = {}
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
        """A task has begun."""
        with self._lock:
            self.running[task] = time.monotonic()
            self._bars[task] = self._live.add_task(f"  {task.name}", total=1.0, note="")

    def finished(self, outcome: Outcome) -> None:
        """A task has ended: one line."""
        with self._lock:
            self.running.pop(outcome.task, None)
            self.ended[outcome.task] = outcome.seconds
            if outcome.task in self._bars:
                self._live.remove_task(self._bars.pop(outcome.task))
        count = f"[{len(self.ended)}/{len(self.tasks)}]"
        name = f"{outcome.task.stage:11} {outcome.task.label}"
        if outcome.error is None:
            self._say(f"{count} {name}  {outcome.seconds:.1f} s")
        else:
            self._say(f"{count} {name}  FAILED: {outcome.error}")
            if outcome.seconds:
                self._say(f"        its log: {self.store.log(outcome.task)}")

    def _say(self, line: str) -> None:
        self.console.print(line, soft_wrap=True)

    def _follow(self) -> None:
        heard = time.monotonic()
        while not self._stop.wait(0.5):
            with self._lock:
                shares = {task: self._share(task) for task in self.running}
                for task, (fraction, message) in shares.items():
                    self._live.update(self._bars[task], completed=fraction, note=escape(message))
            done, left = self._estimate({task: share for task, (share, _) in shares.items()})
            note = f"about {_words(left)} left" if left is not None else ""
            self._live.update(self._total, completed=done, note=note)
            if not self.console.is_terminal and time.monotonic() - heard > HEARTBEAT:
                heard = time.monotonic()
                running = ", ".join(f"{t.name} {s:.0%}" for t, (s, _) in shares.items())
                self._say(f"  … {done:.0%} {note}: {running}")

    def _share(self, task: Task) -> tuple[float, str]:
        state = read_progress(self.store.progress(task))
        return float(state.get("fraction", 0.0)), str(state.get("message", ""))

    def _estimate(self, shares: dict[Task, float]) -> tuple[float, float | None]:
        """The share of the whole that is done, and the seconds left."""
        expected = expectations(self.ended)
        weights = {task: self.ended.get(task) or expected(task.stage) for task in self.tasks}
        total = sum(weights.values())
        done = sum(weights[task] for task in self.ended)
        done += sum(weights[task] * share for task, share in shares.items())
        elapsed = time.monotonic() - self.began
        if elapsed < 3 or done <= 0.01 * total:
            return done / total, None
        return done / total, elapsed * (total - done) / done


def expectations(ended: Mapping[Task, float]) -> Callable[[str], float]:
    """Seconds that a stage is expected to take, from those that `ended` took.

    The mean of its kind; of a kind that has not been seen, what is usual times how much slower or
    faster than usual the others were.
    """
    # One that was never begun, since another had failed, took no time.
    took = {task: seconds for task, seconds in ended.items() if seconds}
    kinds: dict[str, list[float]] = {}
    for task, seconds in took.items():
        kinds.setdefault(task.stage, []).append(seconds)
    usual = sum(EXPECTED.get(task.stage, 1.0) for task in took)
    pace = sum(took.values()) / usual if usual else 1.0

    def expected(stage: str) -> float:
        seen = kinds.get(stage)
        return fmean(seen) if seen else pace * EXPECTED.get(stage, 1.0)

    return expected


def _words(seconds: float) -> str:
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


class Bar(Told):
    """How far one thing is that runs in this process: a bar in a terminal, nothing elsewhere.

    Args:
        console: where to write.
    """

    def __init__(self, console: Console) -> None:
        super().__init__()
        columns = (TextColumn("{task.description}"), BarColumn(bar_width=30))
        self._live = Progress(
            *columns,
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
            transient=True,
        )
        self._task = self._live.add_task("", total=1.0)

    def __enter__(self) -> "Bar":
        self._live.start()
        return self

    def __exit__(self, *raised: object) -> None:
        self._live.stop()

    def _tell(self, fraction: float, message: str) -> None:
        self._live.update(self._task, completed=fraction, description=message)
