"""Collect a multiverse from the folders of its stages, and write its results folder."""

import shutil
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from study.common.errors import StudyError
from study.common.files import (
    digest,
    read_checksums,
    read_json,
    sha256,
    write_json,
    write_text,
)
from study.common.provenance import versions
from study.config.grid import Cell
from study.config.settings import Config
from study.metrics.tables.table import CELL
from study.multiverse import folder, report
from study.multiverse.design import Design, Universe
from study.multiverse.effects import effects_of, join
from study.multiverse.folder import Failure, Multiverse
from study.results import checksums
from study.results.folder import settings_of
from study.results.summary import SCORES, run_each
from study.workflow.failures import failed_stage
from study.workflow.source import source_digests
from study.workflow.store import Store
from study.workflow.task import Task

METRICS = ("mmd2", "brier", "energy_score")
"""The mean scores of each cell in ``cells.parquet``."""
DIAGNOSTICS = ("beta", "kl")
"""The numbers of each fit in ``cells.parquet``; NaN where a model has none."""
COLUMNS = ("universe", *CELL, *METRICS, *DIAGNOSTICS)

RECORDING = Path("recordings") / "multiverse.rrd"
STATE = Path("work") / "published.json"
"""Holds a digest of all that the results folder was written from, and those of its tables."""
PAGES = ("README.md", "choices.md")
FILES = (*folder.FILES, *PAGES, "figures/*", "recordings/*")
"""The files with checksums. Other files, such as notes, have none."""

Tasks = Mapping[str, Mapping[Cell, Task]]
"""The task `evaluate` of every cell, by universe."""


def collect(
    config: Config, design: Design, universes: Sequence[Universe], tasks: Tasks, store: Store
) -> Multiverse:
    """The effects and scores of all universes, as far as their stages have run.

    A universe with cells that failed has the effects of the claims that need none of them. A
    universe of which no stage has failed and some have not run has no effects.

    Args:
        config: the settings that all universes share.
        design: the choices.
        universes: of the design.
        tasks: of the universes.
        store: the folders of the tasks.
    """
    scores = _Scores(store)
    further_seeds = set(design.further_seeds) - set(config.grid.seeds)
    effects, rows, repeats, failures = [], [], [], []
    for universe in universes:
        judged, further = _by_seed(tasks[universe.name], further_seeds)
        complete = {cell: task for cell, task in judged.items() if scores.has(task)}
        failed = list(_failures(universe.name, judged, scores, store))
        failures += [*failed, *_failures(universe.name, further, scores, store)]
        repeats += [
            _row(universe.name, cell, task, scores, store)
            for cell, task in further.items()
            if scores.has(task)
        ]
        if len(complete) + len(failed) < len(judged) or not complete:
            continue
        table = pd.concat([scores.read(cell, task) for cell, task in complete.items()])
        effects.append(effects_of(universe.name, table))
        rows += [_row(universe.name, cell, task, scores, store) for cell, task in complete.items()]
    facts = {"settings": settings_of(config), "versions": versions()}
    return Multiverse(
        design, universes, join(effects), _table(rows), _table(repeats), failures, facts
    )


def _by_seed(
    by_cell: Mapping[Cell, Task], further: Collection[int]
) -> tuple[dict[Cell, Task], dict[Cell, Task]]:
    """The cells of the seeds of the study, from which claims are judged, and those of others."""
    judged = {cell: task for cell, task in by_cell.items() if cell.seed not in further}
    return judged, {cell: task for cell, task in by_cell.items() if cell.seed in further}


def _table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """The table of cells from its rows."""
    numbers = {"seed": "int64", **dict.fromkeys((*METRICS, *DIAGNOSTICS), "float64")}
    types = dict.fromkeys(COLUMNS, "str") | numbers
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype(types)


def publish(multiverse: Multiverse, out: Path) -> bool:
    """Write the results folder, unless it has the same results already.

    Returns:
        whether anything was written.

    Raises:
        StudyError: a figure or the recording could not be written. All other files are.
    """
    tables = {path.name: sha256(path) for path in folder.write(multiverse, out)}
    inputs = digest([tables, dict(source_digests((__name__,)))])
    if _is_current(inputs, out):
        return False
    write_json(out / STATE, {"inputs": "", "tables": tables})
    render(multiverse, out)
    write_json(out / STATE, {"inputs": inputs, "tables": tables})
    return True


def is_own(out: Path) -> bool:
    """Whether the tables of a folder were written by a run with its own ``work/``."""
    try:
        tables = read_json(out / STATE)["tables"]
        return all(sha256(out / name) == tables[name] for name in folder.FILES)
    except (OSError, ValueError, KeyError, TypeError):
        return False


def render(multiverse: Multiverse, out: Path) -> None:
    """Write the pages, the figures, the recording, and the checksums of all files.

    Args:
        multiverse: the results.
        out: the folder. It has their tables already, see `study.multiverse.folder.write`.

    Raises:
        StudyError: a figure or the recording could not be written. All other files are.
    """
    (out / checksums.NAME).unlink(missing_ok=True)
    write_pages(multiverse, out)
    shutil.rmtree(out / "figures", ignore_errors=True)
    problem = None
    try:
        run_each(lambda: _plot(multiverse, out), lambda: _record(multiverse, out))
    except StudyError as error:
        problem = error
    checksums.seal(out, present(out))
    if problem is not None:
        raise problem


def write_pages(multiverse: Multiverse, out: Path) -> None:
    """Write the pages `PAGES`."""
    for name, text in report.pages(multiverse).items():
        write_text(out / name, text)


def present(out: Path) -> list[str]:
    """The sorted names of the files with checksums that are in the folder."""
    files = sorted(path for pattern in FILES for path in out.glob(pattern))
    return [path.relative_to(out).as_posix() for path in files]


def _is_current(inputs: str, out: Path) -> bool:
    """Whether the folder was written from the same inputs, and no file has changed since."""
    try:
        if read_json(out / STATE)["inputs"] != inputs:
            return False
        expected = read_checksums(out / checksums.NAME)
        return all(sha256(out / name) == value for name, value in expected.items())
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _plot(_: Multiverse, out: Path) -> None:
    from paper_figs import specification_curve

    specification_curve.plot(out)


def _record(multiverse: Multiverse, out: Path) -> None:
    from study.recording.multiverse import record_multiverse

    properties = {"study": str(multiverse.facts["settings"]["name"])}
    record_multiverse(out / RECORDING, multiverse, properties)


class _Scores:
    """The scores of cells that claims need. Universes share cells, so they are cached."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._cache: dict[Task, tuple[pd.DataFrame, dict[str, float]]] = {}
        self._complete: dict[Task, bool] = {}

    def has(self, task: Task) -> bool:
        """Whether the scores of a task `evaluate` are complete."""
        if task not in self._complete:
            self._complete[task] = self._store.reason_to_run(task) is None
        return self._complete[task]

    def read(self, cell: Cell, task: Task) -> pd.DataFrame:
        """The scores of a cell that `study.claims.judge` reads."""
        return self._read(task)[0].assign(**asdict(cell))

    def means(self, task: Task) -> dict[str, float]:
        """The mean scores `METRICS`."""
        return self._read(task)[1]

    def _read(self, task: Task) -> tuple[pd.DataFrame, dict[str, float]]:
        if task not in self._cache:
            table = pd.read_parquet(self._store.folder(task) / SCORES)
            of_scenarios = (table["step"] == -1) & (table["scenario"] >= 0)
            ratios = (table["metric"] == "aleatoric_ratio") & (table["dimension"] != "all")
            overall = table[(table["step"] == -1) & (table["scenario"] == -1)]
            overall = overall[overall["dimension"] == "all"]
            by_metric = dict(zip(overall["metric"], overall["value"], strict=True))
            means = {name: float(by_metric[name]) for name in METRICS if name in by_metric}
            self._cache[task] = table[of_scenarios | ratios], means
        return self._cache[task]


def _row(universe: str, cell: Cell, task: Task, scores: _Scores, store: Store) -> dict[str, Any]:
    """The row of one cell in ``cells.parquet``."""
    row: dict[str, Any] = {"universe": universe, **asdict(cell), **scores.means(task)}
    if "trained" in task.inputs:
        fit = read_json(store.folder(task.inputs["trained"]) / "fit.json")
        row |= {name: fit.get(name) for name in DIAGNOSTICS}
    return row


def _failures(
    universe: str, by_cell: Mapping[Cell, Task], scores: _Scores, store: Store
) -> Iterator[Failure]:
    """The cells without scores because a stage failed."""
    for cell, task in by_cell.items():
        if not scores.has(task) and (cause := failed_stage(task, store)):
            error = store.failure(cause).read_text(encoding="utf-8").strip()
            yield Failure(universe, cell.name, cause.name, error)
