"""Command `plan`: print the stages that `all` would run, and the reasons."""

from dataclasses import dataclass

from study.commands.command import Command, StudyOptions
from study.commands.terminal import console, say
from study.common.files import why_not_writable
from study.config.grid import cells, select
from study.results.folder import check_format
from study.results.protection import why_refused
from study.results.publish import why_not_published
from study.workflow.store import Store
from study.workflow.task_cache import record_tasks, topological_order

DETAILS = """\
Nothing runs and nothing is written. Logs of a recorded system have to exist, but `all` alone reads
and checks what is in them. For each stage: up to date, missing, config changed (which
setting), source changed (which module), input changed, or damaged. The last line says whether the
results would be written, or why not.

examples
  python -m study.run plan --config configs/paper.yaml
  python -m study.run plan --vae.latent_size 4"""


@dataclass(frozen=True, kw_only=True)
class Options(StudyOptions):
    """Options of `plan`: the settings alone."""


def run(options: Options) -> int:
    """Print one line for each stage, and whether the results would be written."""
    config, out, terminal = options.config, options.out, console()
    store = Store(out / "work")
    check_format(out)
    selected = select(cells(config), options.only)
    records = record_tasks(config, store)
    states = {
        task: store.reason_to_run(task)
        for task in topological_order(records[cell] for cell in selected)
    }
    for task, why in states.items():
        say(terminal, f"{task.stage:11} {task.label:36} {why or 'up to date'}")
    due = [task for task, why in states.items() if why is not None]
    if refused := why_not_writable(out) or why_refused(config, selected, store, out):
        results = f"`all` will refuse to run: {refused}"
    else:
        results = why_not_published(config, records, store, out, due) or "up to date"
    say(terminal, f"{len(due)} of {len(states)} stages to run; results: {results}")
    return 0


COMMAND = Command("plan", "show what `all` would run, and why", Options, run, DETAILS)
