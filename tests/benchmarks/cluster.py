"""A large study on a large cluster: ``python -m tests.benchmarks.cluster``.

`study.workflow.scheduler` runs some ten thousand stages on 256 simulated workers. The stages are
those of cells with `SEEDS` seeds and `READINGS` readings of the paper, with the durations that were
measured for `results/paper`. Time is simulated, and so are failures: a worker is lost after a
random time, and its stage is tried again. A stage that fails by its own error is not.

Measured are how busy the workers are, the processor time of our scheduler for each stage, and that
of a worker for the lease and the folder of a stage. Dask's own cost is not in it; its documentation
has about a millisecond for each task.
"""

import json
import random
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from heapq import heappop, heappush
from pathlib import Path
from typing import Any
from unittest import mock

from study.commands.settings import CONFIGS
from study.common.files import read_json
from study.common.provenance import MANIFEST
from study.workflow.lease import Terms, hold
from study.workflow.scheduler import run_tasks
from study.workflow.store import Store
from study.workflow.task import Task
from study.workflow.worker import Outcome
from study.workflow.workers import Workers
from tests.benchmarks.report import save

TIMINGS = CONFIGS.parent / "results" / "paper" / "timings.json"
SEEDS, READINGS, WORKERS = 5, 30, 256
CHAIN = ("collect", "ensemble", "tune", "train", "evaluate", "record")
CELLS = tuple(
    (environment, level, model)
    for environment in ("pusher", "uav")
    for level in ("low", "high")
    for model in ("residual_vae", "full_vae", "probabilistic_mlp")
)
LOSSES = (0.0, 0.05, 0.2)
"""Probabilities that the worker of a stage is lost."""
ERRORS = 0.002
"""Probability that a stage fails by its own error."""
PLANNED = (1000, 10000)
"""Numbers of stages for which the cost of `plan` is measured."""
REPEATS = 200
"""Stages of which the cost of lease and folder is measured."""


def study_tasks() -> list[Task]:
    """The tasks of all cells, seeds and readings. Readings share the data and the ensembles."""
    found: dict[str, Task] = {}

    def task(stage: str, label: str, *inputs: Task) -> Task:
        name = f"{stage} {label}"
        if name not in found:
            settings = {"label": label}
            found[name] = Task(stage, label, settings, {i.name: i for i in inputs})
        return found[name]

    for reading in range(READINGS):
        for environment, level, model in CELLS:
            for seed in range(SEEDS):
                data = task("collect", environment)
                part = f"{environment}/{level}"
                ensemble = task("ensemble", f"{part}/{seed}/reading-{reading % 4}", data)
                cell = f"{part}/{model}/{seed}/reading-{reading}"
                tuning = task("tune", cell, data, ensemble)
                trained = task("train", cell, data, ensemble, tuning)
                evaluation = task("evaluate", cell, data, trained)
                checked = task("validate", cell, data, trained)
                record = task("record", cell, data, evaluation, trained)
                task("record_data", cell, record, checked)
    return list(found.values())


def durations() -> Mapping[str, list[float]]:
    """The seconds of the stages that were measured, by stage."""
    measured: dict[str, list[float]] = defaultdict(list)
    for name, seconds in read_json(TIMINGS)["seconds"].items():
        measured[name.split()[0]].append(seconds)
    measured["validate"] = measured["evaluate"]
    return measured


class Simulated(Workers):
    """Workers in simulated time, in which calls to `wait` advance.

    Args:
        count: number of workers.
        loss: probability that the worker of a stage is lost, at a random moment of it.
        seconds: measured durations by stage.
    """

    def __init__(self, count: int, loss: float, seconds: Mapping[str, list[float]]) -> None:
        self.count, self.loss, self.seconds = count, loss, seconds
        self.now, self.busy, self.wasted, self.lost = 0.0, 0.0, 0.0, 0
        self.simulating = 0.0
        self._chance = random.Random(0)
        self._events: list[tuple[float, int, Future[Outcome], Outcome | None, float]] = []

    def capacity(self) -> Mapping[str, int]:
        """All workers, always."""
        return {"": self.count}

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """A stage that ends later."""
        began = time.process_time()
        task, future = args[0], Future[Outcome]()
        length = self._chance.choice(self.seconds[task.stage])
        is_lost = self._chance.random() < self.loss
        error = "ValueError" if self._chance.random() < ERRORS else None
        outcome = None if is_lost else Outcome(task, length, error)
        length *= self._chance.random() if is_lost else 1.0
        heappush(self._events, (self.now + length, id(future), future, outcome, length))
        self.simulating += time.process_time() - began
        return future

    def wait(self, futures: Iterable[Any], **options: Any) -> tuple[set[Any], set[Any]]:
        """Advance to the next end of a stage."""
        began = time.process_time()
        self.now, _, future, outcome, length = heappop(self._events)
        self.busy += length
        if outcome is None:
            self.lost, self.wasted = self.lost + 1, self.wasted + length
            future.set_exception(RuntimeError("simulated"))
        else:
            future.set_result(outcome)
        self.simulating += time.process_time() - began
        return {future}, set()


def simulate(tasks: list[Task], loss: float) -> dict[str, Any]:
    """Run the tasks in simulated time."""
    workers = Simulated(WORKERS, loss, durations())
    with (
        tempfile.TemporaryDirectory() as folder,
        mock.patch("study.workflow.scheduler.wait", workers.wait),
    ):
        began = time.process_time()
        errors = run_tasks(
            tasks, Store(Path(folder)), workers, 1, lambda _: None, lambda _: None, Terms()
        )
        ours = time.process_time() - began - workers.simulating
    return {
        "loss": loss,
        "stages": len(tasks),
        "workers": WORKERS,
        "hours": workers.now / 3600,
        "busy": workers.busy / workers.now / WORKERS,
        "wasted": workers.wasted / workers.busy,
        "lost": workers.lost,
        "failed": len(errors),
        "scheduler_ms": 1000 * ours / len(tasks),
        "scheduler_share": ours / workers.now,
    }


def worker_cost() -> float:
    """Processor seconds of a worker for the lease and the folder of a stage."""
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder))
        began = time.process_time()
        for number in range(REPEATS):
            task = Task("train", str(number), {"number": number})
            with hold(store.lease(task), Terms()) as lease:
                out = store.begin(task, False, lease.token)
                (out / "scores.txt").write_text("0")
                store.finish(task, {}, {}, lease.token, lease.verify)
        return (time.process_time() - began) / REPEATS


def reason_cost(count: int) -> float:
    """Processor seconds of `plan` for each of `count` tasks, all of which have changed settings."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for number in range(count):
            done = Task("train", str(number), {"number": number, "steps": 1})
            out = Store(root).folder(done)
            out.mkdir(parents=True)
            facts = {"label": done.label, "settings": dict(done.settings), "inputs": {}}
            (out / MANIFEST).write_text(json.dumps(facts))
        store, began = Store(root), time.process_time()
        for number in range(count):
            assert store.reason_to_run(Task("train", str(number), {"number": number, "steps": 2}))
        return (time.process_time() - began) / count


def main() -> None:
    """Measure, print and save."""
    tasks, rows = study_tasks(), []
    cost = worker_cost()
    for loss in LOSSES:
        row = simulate(tasks, loss)
        work = row["busy"] * row["workers"] * row["hours"] * 3600
        row["worker_ms"] = 1000 * cost
        row["our_share"] = (row["scheduler_ms"] / 1000 + cost) * row["stages"] / work
        rows.append(row)
        print(
            f"{row['stages']:,} stages on {WORKERS} workers, {loss:.0%} lost: "
            f"{row['hours']:.1f} h, workers {row['busy']:.1%} busy, {row['wasted']:.1%} of it "
            f"for lost stages, {row['lost']} lost, {row['failed']} failed or not run\n"
            f"  our scheduler {row['scheduler_ms']:.2f} ms a stage "
            f"({row['scheduler_share']:.2%} of one core), lease and folder "
            f"{row['worker_ms']:.2f} ms: {row['our_share']:.3%} of the workers' time",
            flush=True,
        )
    costs = {count: 1000 * reason_cost(count) for count in PLANNED}
    print(", ".join(f"plan of {n:,} stages: {ms:.2f} ms a stage" for n, ms in costs.items()))
    save("cluster", rows)


if __name__ == "__main__":
    main()
