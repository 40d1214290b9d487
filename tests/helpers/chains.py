"""A study without training, to test engines: chains of stages that sleep, and write what they read.

``python -m tests.helpers.chains OUT [--engine.…]`` runs it. The module is the plugin of its tasks:
a worker that imports it knows the stage `link`. A link resumes where it was stopped.
"""

import hashlib
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from study.common.errors import StudyError
from study.common.files import sha256
from study.common.progress import Progress
from study.config.settings import Engine
from study.config.stage_settings import STAGES
from study.workflow.engine import start, terms
from study.workflow.lock import locked
from study.workflow.scheduler import run_tasks
from study.workflow.store import Store
from study.workflow.task import Task
from study.workflow.worker import Outcome

STAGE = "link"
CHAINS, LENGTH, STEPS = 4, 4, 8
SCRATCH = 300_000
"""Bytes that a link writes into the folder of temporary files of its worker."""


@dataclass(frozen=True)
class LinkSettings:
    """The settings of one link; with `error` it fails by an error of its own."""

    chain: int
    number: int
    seconds: float
    error: bool = False


def run(settings: LinkSettings, inputs: Mapping[str, Path], out: Path, progress: Progress) -> None:
    """Append a line for each step: a hash of the line before, beginning with the inputs."""
    if settings.error:
        raise ValueError("this link is broken")
    journal = out / "journal.txt"
    lines = journal.read_text().split("\n")[:-1] if journal.exists() else []
    before = (
        "".join((path / "journal.txt").read_text() for _, path in sorted(inputs.items()))
        + f"{settings.chain}/{settings.number}"
    )
    for step in range(STEPS):
        text = lines[step - 1] if step else before
        if step >= len(lines):
            lines.append(hashlib.sha256(f"{step} {text}".encode()).hexdigest())
            with journal.open("w") as file:
                file.write("\n".join(lines) + "\n")
            with tempfile.TemporaryFile() as scratch:
                scratch.write(bytes(SCRATCH))
                scratch.flush()
            time.sleep(settings.seconds / STEPS)
        progress((step + 1) / STEPS, f"step {step + 1}")


def tasks(seconds: float = 0.8, broken: int | None = None) -> list[Task]:
    """Chains that begin at one link and end in one link.

    Args:
        seconds: that a link sleeps.
        broken: the chain whose second link fails.
    """

    def link(chain: int, number: int, inputs: Mapping[str, Task]) -> Task:
        settings = LinkSettings(chain, number, seconds, (chain, number) == (broken, 1))
        label = f"chain-{chain}/{number}"
        return Task(STAGE, label, asdict(settings), inputs, {}, ("tests.helpers.chains",))

    found = [link(0, 0, {})]
    last = {}
    for chain in range(1, CHAINS + 1):
        task = found[0]
        for number in range(1, LENGTH + 1):
            task = link(chain, number, {"previous": task})
            found.append(task)
        last[f"chain-{chain}"] = task
    return [*found, link(0, LENGTH + 1, last)]


def journals(out: Path) -> dict[str, str]:
    """The SHA-256 of the files of all links, by name."""
    return {
        str(path.relative_to(out)): sha256(path)
        for path in sorted(out.glob(f"work/{STAGE}/[!.]*/journal.txt"))
    }


def run_chains(out: Path, engine: Engine, every: list[Task]) -> dict[str, str]:
    """Run the links that are not up to date; returns the errors by label."""
    store = Store(out.resolve() / "work")
    store.root.mkdir(parents=True, exist_ok=True)

    def ended(outcome: Outcome) -> None:
        print(f"{outcome.task.label}: {outcome.error or 'complete'}", flush=True)

    def lost(task: Task, why: str) -> None:
        print(f"{task.label}: the worker was lost ({why})", flush=True)

    with locked(out) as lock:
        due = [task for task in every if store.reason_to_run(task) is not None]
        with start(engine, store.root, due) as workers:
            errors = run_tasks(due, store, workers, 1, lambda _: None, ended, terms(engine), lost)
        lock.verify()
    return {task.label: error for task, error in errors.items()}


def _register() -> None:
    """Make the stage known, as if it were a module of `study.stages`."""
    stage: Any = ModuleType(f"study.stages.{STAGE}")
    stage.run, stage.RESUMABLE = run, True
    sys.modules[stage.__name__] = stage
    STAGES[STAGE] = LinkSettings  # type: ignore[index]


def main(arguments: list[str]) -> int:
    """Run the chains on the cluster whose address is given, or in this process without one."""
    out, address, lease = Path(arguments[0]), arguments[1], int(arguments[2])
    kind = "dask" if address else "serial"
    try:
        engine = Engine(kind=kind, address=address, lease=lease)
        return 1 if run_chains(out, engine, tasks(seconds=2.0)) else 0
    except StudyError as error:
        print(f"error: {error}", flush=True)
        return error.exit_code


_register()
if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
