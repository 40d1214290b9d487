"""The command line: ``python -m study.run all``. Thin: each command is a few calls."""

import importlib
import os
import sys
import tempfile
from pathlib import Path

from rich.console import Console

from study.commands.display import Display
from study.commands.parser import Command, parse
from study.commands.view import check_cell, known_cells, recording_of
from study.common.errors import BadInput, StudyError
from study.config.grid import cells, select
from study.models.gru import compiler
from study.results import folder
from study.results.writable import check_writable, make
from study.workflow.engine import executor, quiet_rerun, workers
from study.workflow.lock import locked
from study.workflow.scheduler import run_tasks
from study.workflow.store import Store, Task
from study.workflow.task_cache import line_up, record_tasks, remember

# torch, lightning and mujoco take seconds to import: only the commands that need them do.


def main(arguments: list[str] | None = None) -> int:
    """Run a command.

    Returns:
        the exit code: 0 all is well, 1 some stage failed, 2 bad input, 130 interrupted.
    """
    try:
        command = parse(sys.argv[1:] if arguments is None else arguments)
        _import_plugins(command)
        return {
            "all": run_all,
            "plan": show_plan,
            "status": show_status,
            "figures": draw_figures,
            "view": view,
            "compare": compare,
            "portrait": portrait,
            "export": export,
            "forecast": forecast,
            "verify": verify,
            "join": join,
            "ablate": ablate,
        }[command.command](command)
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except OSError as error:
        # A full disk, a folder that went away: nothing that is complete is lost.
        print(
            f"error: {error}; free the place or use another --out, and run again", file=sys.stderr
        )
        return 1
    except KeyboardInterrupt:
        print("stopped: run the same command again to go on from here", file=sys.stderr)
        return 130


def run_all(command: Command) -> int:
    """Run what is not up to date, then publish."""
    from study.commands import status
    from study.results import checksums, publish

    config, console, store = command.config, _console(), _store(command)
    chosen = select(cells(config), command.only)
    check_writable(command.out)
    records = record_tasks(config, store)
    make(command.out)
    with locked(command.out):
        remember(config, records, store)
        tasks = line_up(records[cell] for cell in chosen)
        store.forget_progress()
        due = {task: why for task in tasks if (why := store.why_not(task)) is not None}
        for task, why in due.items():
            if why.startswith("damaged"):
                _say(console, f"{task.name}: {why}; it is made again")
        errors = _run_due(command, list(due), store, console) if due else {}
        changed = publish.publish(config, records, store, command.out)
        if due or changed or checksums.problems(command.out):
            status.write_timings(line_up(records.values()), store, config, command.out)
            checksums.write(command.out)
            changed = True
        if not due and not changed:
            _say(console, f"{command.out}: everything is up to date, nothing to run")
        elif not due:
            _say(console, f"{command.out}: no stage to run, results written again")
        status.print_table(console, config, records, store, errors, command.out)
    return 1 if errors else 0


def _run_due(command: Command, due: list[Task], store: Store, console: Console) -> dict[Task, str]:
    engine = command.config.engine
    side_by_side = min(workers(engine), len(due))
    stages = "1 stage" if len(due) == 1 else f"{len(due)} stages"
    _say(console, f"{stages} to run, {side_by_side} at a time; results in {command.out}")
    if compiler.find() is None:
        _say(console, "no C compiler: recurrent networks run in plain torch, at half the speed")
    with (
        Display(due, store, console, side_by_side) as display,
        executor(engine) as pool,
    ):
        return run_tasks(
            due, store, pool, side_by_side, engine.threads, display.started, display.finished
        )


def show_plan(command: Command) -> int:
    """What `all` would run, and why."""
    from study.results import publish

    console, store = _console(), _store(command)
    check_writable(command.out)
    chosen = select(cells(command.config), command.only)
    records = record_tasks(command.config, store)
    tasks = line_up(records[cell] for cell in chosen)
    states = {task: store.why_not(task) for task in tasks}
    for task, why in states.items():
        _say(console, f"{task.stage:11} {task.label:36} {why or 'up to date'}")
    due = [task for task, why in states.items() if why is not None]
    unpublished = publish.why_not_published(command.config, records, store, command.out, due)
    publishing = f"results: {unpublished or 'up to date'}"
    _say(console, f"{len(due)} of {len(tasks)} stages to run; {publishing}")
    return 0


def show_status(command: Command) -> int:
    """What is done, running and failed, and what it took."""
    from study.commands import status

    if not command.out.is_dir():
        raise BadInput(f"--out: there is no study in {command.out}; python -m study.run all")
    store = _store(command)
    chosen = select(cells(command.config), command.only)
    records = record_tasks(command.config, store)
    tasks = line_up(records[cell] for cell in chosen)
    side_by_side = None if command.only else status.last_workers(command.config, command.out)
    status.print_status(_console(), tasks, store, command.out, side_by_side)
    return 0


def draw_figures(command: Command) -> int:
    """Tables and figures again, from the results alone."""
    from study.results import publish

    for path in publish.draw(command.out):
        print(path)
    return 0


def view(command: Command) -> int:
    """Open a recording; or, with no screen, write pictures of all its views."""
    from study.recording.viewer import open_viewer, screenshots

    path = recording_of(command)
    if command.save is None:
        open_viewer([path])
        return 0
    try:
        shown = screenshots(path, Path(command.save))
    except (NotADirectoryError, FileExistsError):
        raise BadInput(f"--save: '{command.save}' is no folder") from None
    print(*shown.pages, *shown.views.values(), sep="\n")
    for problem in shown.problems:
        print(f"error: {problem}", file=sys.stderr)
    return 1 if shown.problems else 0


def compare(command: Command) -> int:
    """Cells side by side."""
    from study.commands import compare

    known = [cell.name for cell in known_cells(command)]
    for name in command.cells:
        check_cell(name, known)
    folder = command.out / "recordings"
    differing, scores = compare.compare({n: folder / n / "scores.rrd" for n in command.cells})
    compare.print_comparison(_console(), differing, scores)
    return 0


def portrait(command: Command) -> int:
    """Write a page about the environments."""
    from study.commands.display import Bar
    from study.envs import simulators
    from study.envs.card.readme import write

    names = [command.environment] if command.environment else list(command.config.grid.environments)
    for name in names:
        simulators[name]
    folder = Path(command.to) if command.to else command.out / "environments"
    with Bar(_console()) as bar:
        written = write(command.config.collect, names, folder, bar)
    print(*written, sep="\n")
    return 0


def export(command: Command) -> int:
    """Write an environment's training trajectories as a Minari data set."""
    from study.commands.display import Bar
    from study.data.minari import prepare

    planned = prepare(
        command.config, str(command.environment), Path(command.to) if command.to else None
    )
    count = command.config.collect.trajectories
    print(f"{count} trajectories are simulated and written to {planned.folder}", flush=True)
    with Bar(_console()) as bar:
        planned.write(bar)
    place = f", with MINARI_DATASETS_PATH={planned.root}" if command.to else ""
    print(f'minari.load_dataset("{planned.id}") loads them{place}')
    return 0


def forecast(command: Command) -> int:
    """Forecast one scenario, or a plan, with the weights that the study ships."""
    quiet_rerun()
    from study.commands.display import Bar
    from study.commands.forecast import (
        Question,
        answer,
        print_answer,
        read_scenario,
        save,
        simulator_of,
    )
    from study.data.plan_files import write_plan
    from study.recording.viewer import open_viewer

    if command.scenario is None and command.file is None:
        raise BadInput("--scenario: its value is missing; or give a plan with --file")
    if command.samples is not None and command.samples < 2:
        raise BadInput(f"--samples: got {command.samples}; it must be at least 2")
    if command.save is not None and not command.save.endswith(".rrd"):
        raise BadInput(f"--save: got '{command.save}'; a recording is a .rrd file")
    study = folder.read(command.out)
    cell = study.cell(str(command.cell), "--cell")
    question = Question(
        study,
        cell,
        command.scenario or 0,
        None if command.file is None else Path(command.file),
        command.samples,
    )
    plan, simulator = read_scenario(question), simulator_of(study, cell.environment)
    if command.write is not None:
        write_plan(Path(command.write), simulator, plan)
        print(command.write)
        return 0
    with Bar(_console()) as bar:
        example = answer(question, plan, bar)
    print_answer(_console(), question, simulator, example)
    path = Path(command.save or Path(tempfile.mkdtemp(prefix="study-"), "forecast.rrd"))
    save(path, question, simulator, example)
    if command.save is None:
        open_viewer([path])
    print(f"\nrecording: {path}")
    return 0


def verify(command: Command) -> int:
    """Check a study's results: one line a check."""
    from study.commands.display import Bar
    from study.results.verify import verify

    study = folder.read(command.out)
    cell = None if command.rerun is None else study.cell(command.rerun, "--rerun")
    console, all_well = _console(), True
    with Bar(console) as bar:
        for found in verify(study, cell, bar):
            _say(console, found.line)
            all_well &= found.ok
    return 0 if all_well else 1


def join(command: Command) -> int:
    """Write one study of the seeds of several."""
    from study.results.join import join

    join([Path(folder) for folder in command.folders], command.out)
    print(command.out)
    return 0


def ablate(command: Command) -> int:
    """Fit what the list of changes asks for, and write the table."""
    from study.commands import ablate

    console, store = _console(), _store(command)
    check_writable(command.out)
    planned = ablate.plan(command.variants, command.only)
    make(command.out)
    with locked(command.out):
        tasks = line_up(task for of_cells in planned.values() for task in of_cells.values())
        store.forget_progress()
        due = [task for task in tasks if store.why_not(task) is not None]
        errors = _run_due(command, due, store, console) if due else {}
        for task, error in errors.items():
            _say(console, f"{task.name}: {error}")
        _say(console, str(ablate.write(command.out, command.config, planned, store)))
    return 1 if errors else 0


def _store(command: Command) -> Store:
    return Store(command.out / "work")


def _console() -> Console:
    # Bound to this output: a stage that runs in this process sends its own elsewhere. A file is
    # as wide as a table needs.
    width = None if sys.stdout.isatty() else 200
    return Console(file=sys.stdout, width=width, highlight=False, markup=False)


def _say(console: Console, line: str) -> None:
    console.print(line, soft_wrap=True)


def _import_plugins(command: Command) -> None:
    """Import the user's own modules, which register environments and models."""
    sys.path.insert(0, os.getcwd())
    for plugin in command.config.plugins:
        try:
            importlib.import_module(plugin)
        except ImportError as error:
            raise BadInput(f"plugins: cannot import '{plugin}': {error}") from None


if __name__ == "__main__":
    sys.exit(main())
