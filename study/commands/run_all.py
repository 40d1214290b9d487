"""Command `all`: run the stages that are not up to date, then publish the results."""

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from study.commands.command import Command, StudyOptions
from study.commands.display import run_displayed
from study.commands.logs import check_logs
from study.commands.machine import check_accelerator, check_memory
from study.commands.terminal import console, say
from study.common.errors import BadInput, StudyError
from study.config.grid import cells, select
from study.config.settings import Config, Engine
from study.results import checksums, timings
from study.results.folder import STUDY, check_writable, create, write_run_settings
from study.results.protection import why_refused
from study.results.publish import Records, publish
from study.workflow.engine import workers
from study.workflow.lock import locked
from study.workflow.searches import with_database
from study.workflow.store import Store
from study.workflow.task import Task
from study.workflow.task_cache import record_tasks, topological_order, write_cache

DETAILS = """\
A stage is up to date if neither its settings nor its inputs changed. A stopped run continues where
it stopped. Results are written to OUT, and files of the stages to OUT/work.

exit  0 if all is well, 1 if a stage failed (the other stages still run), 2 if the input is wrong

examples
  python -m study.run all
  python -m study.run all --config configs/paper.yaml --engine.workers 8
  python -m study.run all --grid.models all --grid.seeds '[0, 1]' --name mine
  python -m study.run all --only 'uav/low/*' --tune.trials 12"""

UP_TO_DATE = "everything is up to date, nothing to run"


@dataclass(frozen=True, kw_only=True)
class Options(StudyOptions):
    """Options of `all`: the settings alone."""


def run(options: Options) -> int:
    """Run the stages that are not up to date, publish, and print the final table."""
    from study.commands.final_table import print_table

    config, out, terminal = options.config, options.out, console()
    store = Store(out / "work")
    selected = select(cells(config), options.only)
    check_writable(out)
    check_memory(config)
    records = record_tasks(config, store)
    tasks = topological_order(records[cell] for cell in selected)
    check_accelerator(config, tasks, store)
    if refused := why_refused(config, selected, store, out):
        raise BadInput(f"--out: {refused}; give another --out")
    check_logs(config, tasks, store, terminal)
    create(out)
    with locked(out) as lock:
        write_run_settings(out, config)
        write_cache(config, records, store)
        store.remove_leftovers()
        due = {task: why for task in tasks if (why := store.reason_to_run(task)) is not None}
        for task, why in due.items():
            if why.startswith("damaged"):
                say(terminal, f"{task.name}: {why}; it runs again")
        ready = with_database(due, config)
        errors = run_due(ready, config.engine, store, terminal) if ready else {}
        problem = None
        lock.verify()
        try:
            changed = _publish(config, records, store, out, bool(due))
        except StudyError as error:  # a figure could not be written; all other files are
            changed, problem = True, error
        if not due:
            written = "no stage to run, results written again"
            say(terminal, f"{out}: {written if changed else UP_TO_DATE}")
        print_table(terminal, config, records, store, errors, out)
        if problem is not None:
            say(terminal, f"FAILED {problem}")
    return 1 if errors or problem else 0


def _publish(config: Config, records: Records, store: Store, out: Path, has_run: bool) -> bool:
    """Bring the results up to date, with timings, checksums and the page.

    Returns:
        whether the files of the results were written.

    Raises:
        StudyError: results that cannot be computed again would be lost, and nothing was written; or
            a figure could not be written, and all other files were.
    """
    complete = [cell for cell, task in records.items() if store.reason_to_run(task) is None]
    if refused := why_refused(config, complete, store, out):
        raise StudyError(f"results are not published: {refused}; run the failed stages again")
    problem = None
    try:
        changed = publish(config, records, store, out)
    except StudyError as error:
        changed, problem = True, error
    if has_run or changed:
        timings.write(topological_order(records.values()), store, config, out)
        checksums.write(out)
        if (out / STUDY).is_file():  # no cell may be complete
            from study.page.write import write_page

            write_page(out)
    if problem is not None:
        raise problem
    return changed


def run_due(due: list[Task], engine: Engine, store: Store, terminal: Console) -> dict[Task, str]:
    """Print the number of stages to run, and run them.

    Returns:
        the error of every task that failed or was not run.
    """
    from study.models.unroll import compiler

    stages = "1 stage" if len(due) == 1 else f"{len(due)} stages"
    parallel = f"{min(workers(engine), len(due))} at a time"
    if engine.address:
        most = f"at most {engine.workers}" if engine.workers else "the"
        parallel = f"on {most} workers of {engine.address}"
    say(terminal, f"{stages} to run, {parallel}; results in {store.root.parent}")
    if compiler.find() is None:
        say(terminal, "no C compiler: networks are unrolled in plain torch, at half the speed")
    return run_displayed(due, engine, store, terminal)


COMMAND = Command(
    "all",
    "run the stages that are not up to date, then write tables, figures, recordings and a page",
    Options,
    run,
    DETAILS,
)
