"""Command `plan`: print the stages that `all` would run, and the reasons."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated

from rich.console import Console

from study.commands.command import Command, Flag, StudyOptions
from study.commands.estimate import durations, in_words
from study.commands.terminal import console, say
from study.common.errors import BadInput
from study.common.files import why_not_writable
from study.config.grid import cells, select
from study.results import timings
from study.results.folder import check_format
from study.results.protection import why_refused
from study.results.publish import why_not_published
from study.workflow.simulation import critical_path, simulate
from study.workflow.store import Store
from study.workflow.task import Task
from study.workflow.task_cache import record_tasks, topological_order

DETAILS = """\
Nothing runs and nothing is written. Logs of a recorded system have to exist, but only `all` reads
and checks their content. For each stage: up to date, missing, config changed (which
setting), source changed (which module), input changed, or damaged. The last line says whether the
results would be written, or why not.

With --workers, the duration on so many workers follows. It comes from a simulation of the scheduler
with the durations of stages that have run, or with rough ones where none of a stage and environment
has. The critical path is the longest chain of stages: more workers do not make it shorter.

examples
  python -m study.run plan --config configs/paper.yaml
  python -m study.run plan --vae.latent_size 4
  python -m study.run plan --config configs/paper.yaml --workers 64"""


@dataclass(frozen=True, kw_only=True)
class Options(StudyOptions):
    """Options of `plan`.

    Attributes:
        workers: number of workers of the estimate; None prints none.
    """

    workers: Annotated[int | None, Flag("estimate wall time and core hours on so many workers")] = (
        None
    )


def run(options: Options) -> int:
    """Print one line for each stage, whether the results would be written, and the estimate.

    Raises:
        BadInput: the number of workers is not positive.
    """
    if options.workers is not None and options.workers < 1:
        raise BadInput(f"--workers: got {options.workers}; it must be at least 1")
    config, out, terminal = options.config, options.out, console()
    store = Store(out / "work")
    check_format(out)
    selected = select(cells(config), options.only)
    records = record_tasks(config, store)
    states = {
        task: store.reason_to_run(task)
        for task in topological_order(records[cell] for cell in selected)
    }
    width = _width(states)
    for task, why in states.items():
        say(terminal, f"{task.stage:11} {task.label:{width}} {why or 'up to date'}")
    due = [task for task, why in states.items() if why is not None]
    if refused := why_not_writable(out) or why_refused(config, selected, store, out):
        results = f"`all` will refuse to run: {refused}"
    else:
        results = why_not_published(config, records, store, out, due) or "up to date"
    say(terminal, f"{len(due)} of {len(states)} stages to run; results: {results}")
    if options.workers is not None and due:
        published = {} if store.root.is_dir() else timings.read(out)
        ended = [task for task, why in states.items() if why is None]
        measured = {
            task: (store.timing(task) or timings.of(task, published)).get("seconds")
            for task in [*ended, *(task for task in due if timings.of(task, published))]
        }
        _print_estimate(terminal, due, measured, options.workers, config.engine.threads)
    return 0


def _print_estimate(
    terminal: Console,
    due: list[Task],
    measured: Mapping[Task, float | None],
    workers: int,
    threads: int,
) -> None:
    seconds = durations(due, measured)
    forecast, path = simulate(due, seconds, workers), critical_path(due, seconds)
    hours = sum(seconds.values()) * threads / 3600
    workers_named = "1 worker" if workers == 1 else f"{workers} workers"
    say(
        terminal,
        f"on {workers_named}: about {in_words(forecast.seconds)}, {forecast.busy:.0%} busy, "
        f"{hours:.2g} core hours; durations from {sum(map(bool, measured.values()))} stages that "
        "have run",
    )
    say(terminal, f"critical path, {in_words(sum(seconds[task] for task in path))}:")
    width = _width(path)
    for task in path:
        say(terminal, f"  {task.stage:11} {task.label:{width}} {in_words(seconds[task])}")


def _width(tasks: Iterable[Task]) -> int:
    """The length of the longest label."""
    return max((len(task.label) for task in tasks), default=0)


COMMAND = Command("plan", "show what `all` would run, and why", Options, run, DETAILS)
