"""Command `multiverse`: judge the claims in many readings of the paper."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from study.commands.command import Argument, Command, Flag, StudyOptions
from study.commands.estimate import estimate, in_words
from study.commands.settings import CONFIGS
from study.commands.terminal import console, say
from study.commands.variants import Variants, last_tasks, run_missing, tasks_of
from study.common.errors import BadInput, StudyError, nearest
from study.config.settings import Config
from study.config.stage_settings import STAGES
from study.multiverse.design import Design, Universe, check_settings, config_of_universe
from study.multiverse.read import PART, design_from
from study.multiverse.universes import universes as universes_of
from study.results.folder import check_writable, create
from study.workflow.engine import workers
from study.workflow.lock import locked
from study.workflow.store import Store
from study.workflow.task import Task

if TYPE_CHECKING:
    from study.results.reuse import Reusable

ACTIONS = ("run", "plan")

DETAILS = """\
The file of settings, configs/multiverse.yaml by default, has the open choices of the paper in its
part `multiverse`. A universe has one value of each choice. Universes share stages; a stopped
multiverse continues where it stopped; after a new value or choice, only what is new runs. Parts
that ran on several machines are joined: see `join --help`. With --reuse, universes of the design
that another multiverse has with the same settings and cells do not run: their results are taken
from there, also with --universes. The code of the study is not compared.
OUT gets README.md, choices.md, multiverse.json, effects.parquet, cells.parquet, repeats.parquet,
figures/ and recordings/multiverse.rrd.

what  run; or plan, which lists the universes with the stages to run and the time that they take

exit  0 if all is well, 1 if a stage failed (the other universes still run), 2 if the input is wrong

examples
  python -m study.run multiverse plan
  python -m study.run multiverse
  python -m study.run multiverse --universes 'as_written*' --out results/readings
  python -m study.run multiverse --grid.seeds '[0, 1]' --engine.workers 8
  python -m study.run multiverse --reuse results/multiverse --out results/mine"""


@dataclass(frozen=True, kw_only=True)
class Options(StudyOptions):
    """Options of `multiverse`.

    Attributes:
        what: one of `ACTIONS`.
        universes: a pattern of names of universes; None for all.
        reuse: the folder of a multiverse with results to take; None for none.
        multiverse: the part of the file of settings with the design.
    """

    multiverse: Any
    what: Annotated[str, Argument("run or plan")] = "run"
    universes: Annotated[str | None, Flag("universes whose name matches, such as 'random-*'")] = (
        None
    )
    reuse: Annotated[Path | None, Flag("multiverse whose results of equal universes are taken")] = (
        None
    )


def run(options: Options) -> int:
    """Run the universes and write the results, or print the plan."""
    if options.what not in ACTIONS:
        raise BadInput(f"multiverse: got '{options.what}'; {nearest(options.what, ACTIONS)}")
    design = design_from(options.multiverse)
    check_settings(options.config, design)
    every = universes_of(design)
    selected = select(every, options.universes)
    configs = {
        universe.name: config_of_universe(options.config, design, universe) for universe in every
    }
    reusable = _reusable(options, design, configs)
    if options.what == "plan":
        return _print_plan(options, design, selected, configs, reusable)
    check_writable(options.out)
    return _run(options, design, every, selected, configs, reusable)


def select(every: Sequence[Universe], pattern: str | None) -> list[Universe]:
    """The universes whose name matches a pattern.

    Raises:
        BadInput: none matches.
    """
    if pattern is None:
        return list(every)
    chosen = [universe for universe in every if fnmatchcase(universe.name, pattern)]
    if not chosen:
        names = [universe.name for universe in every]
        raise BadInput(f"--universes: none matches '{pattern}'; {nearest(pattern, names)}")
    return chosen


def _reusable(options: Options, design: Design, configs: Mapping[str, Config]) -> "Reusable | None":
    """The results to take from another multiverse."""
    from study.results.reuse import find

    if options.reuse is None:
        return None
    if options.only is not None:
        raise BadInput("--reuse: takes whole universes; leave out --only")
    if options.reuse.resolve() == options.out.resolve():
        raise BadInput(f"--reuse: {options.reuse} is the results folder; give another --out")
    return find(options.reuse, options.config, design, configs)


def _run(
    options: Options,
    design: Design,
    every: Sequence[Universe],
    selected: Sequence[Universe],
    configs: dict[str, Config],
    reusable: "Reusable | None",
) -> int:
    from study.results import multiverse as results
    from study.results.protection_multiverse import why_refused
    from study.results.reuse import add

    out, terminal = options.out, console()
    tasks = _evaluations(configs, options.only)
    create(out)
    store = Store(out / "work")
    taken = _taken(reusable, tasks, store)
    chosen = {u.name: tasks[u.name] for u in selected if u.name not in taken}
    all_cells = tasks if options.only is None else _evaluations(configs, None)

    def why_not(computed: Collection[str]) -> str | None:
        with_all_cells = computed if options.only is None else ()
        return why_refused(configs, with_all_cells, all_cells, store, out)

    if refused := why_not({*chosen, *taken}):
        raise BadInput(f"--out: {refused}; give another --out")
    with locked(out) as lock:
        others = f"; {len(taken)} are taken from {options.reuse}" if taken else ""
        say(terminal, f"{len(chosen)} universes of {len(every)} in the design{others}")
        errors = run_missing(tasks_of(chosen), options.config, store, terminal)
        lock.verify()
        collected = results.collect(options.config, design, every, tasks, store)
        collected = add(collected, reusable) if reusable else collected
        problem, written = None, True
        try:
            failed = {failure.universe for failure in collected.failures}
            if refused := why_not(set(collected.scored) - failed):
                raise StudyError(f"the results are not published: {refused}")
            written = results.publish(collected, out)
        except StudyError as error:  # all other files are written
            problem = error
    for task, message in errors.items():
        say(terminal, f"FAILED {task.name}: {message}  log: {store.log(task)}")
    if problem is not None:
        say(terminal, f"FAILED {problem}")
    say(terminal, f"{len(collected.scored)} of {len(every)} universes have scores")
    for name in ("README.md", "choices.md", "figures", str(results.RECORDING)):
        say(terminal, f"{out / name}{'' if written else '  (up to date)'}")
    return 1 if errors or problem else 0


def _taken(reusable: "Reusable | None", tasks: Variants, store: Store) -> set[str]:
    """The universes whose results are taken, since they are not complete here."""
    from study.results.protection_multiverse import is_complete

    names = reusable.names if reusable else ()
    return {name for name in names if name in tasks and not is_complete(name, tasks, store)}


def _evaluations(configs: dict[str, Config], only: str | None) -> Variants:
    from study.workflow.pipeline import Pipeline

    return last_tasks(configs, only, Pipeline.evaluate, references=True)


def _print_plan(
    options: Options,
    design: Design,
    selected: Sequence[Universe],
    configs: dict[str, Config],
    reusable: "Reusable | None",
) -> int:
    """Print the choices, a line for each universe, and the stages with an estimate of the time."""
    terminal, store = console(), Store(options.out / "work")
    variants = _evaluations({u.name: configs[u.name] for u in selected}, options.only)
    taken = _taken(reusable, variants, store)
    for choice in design.choices:
        counts = Counter(universe.values[choice.name] for universe in selected)
        listed = ", ".join(f"{value} ({counts[value]})" for value in choice.values)
        say(terminal, f"{choice.name:16} {listed}")
    tasks = tasks_of({name: each for name, each in variants.items() if name not in taken})
    due = [task for task in tasks if store.reason_to_run(task) is not None]
    waiting, planned = set(due), set[Task]()
    for universe in selected:
        if universe.name in taken:
            say(terminal, f"{universe.name:36} taken from {options.reuse}")
            continue
        needed = tasks_of({universe.name: variants[universe.name]})
        missing = waiting.intersection(needed)
        new = missing - planned
        planned |= new
        state = f"{len(new)} of {len(needed)} stages to run" if missing else "up to date"
        shared = f", {len(missing - new)} shared with universes above" * (missing != new)
        say(terminal, f"{universe.name:36} {state}{shared}")
    say(terminal, _total(tasks, due, options.config, store))
    return 0


def _total(tasks: list[Task], due: list[Task], config: Config, store: Store) -> str:
    """The number of stages to run, and an estimate of the time that they take."""
    line = f"{len(due)} of {len(tasks)} stages to run"
    if not due:
        return line
    counts, parallel = Counter(task.stage for task in due), workers(config.engine) or 1
    waiting = set(due)
    seconds = estimate(due, (task for task in tasks if task not in waiting), store) / parallel
    by_stage = ", ".join(f"{counts[stage]} {stage}" for stage in STAGES if counts[stage])
    return f"{line} ({by_stage}): about {in_words(seconds)}, {parallel} at a time"


COMMAND = Command(
    "multiverse",
    "judge the claims in many readings of the paper, and find which choice decides them",
    Options,
    run,
    DETAILS,
    config=str(CONFIGS / "multiverse.yaml"),
    part=PART,
)
