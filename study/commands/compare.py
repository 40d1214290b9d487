"""Command `compare`: the settings that differ and the scores of some cells, side by side."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.console import Console
from rich.table import Table

from study.commands.command import Argument, Command, StudyOptions
from study.commands.terminal import console
from study.commands.view import check_cell, known_cells
from study.common.errors import BadInput
from study.config.convert import by_dotted_name
from study.config.grid import Cell
from study.results import folder
from study.results.folder import Results

if TYPE_CHECKING:
    import pandas as pd

DETAILS = """\
Reads study.json, scores.parquet and trials.parquet of OUT. The scores are the rows of
tables/scores_ENVIRONMENT.md for these cells alone: a mean over scenarios, steps and dimensions, or
the median of a variance ratio over dimensions and steps from the eleventh on.

example
  python -m study.run compare uav/low/residual_vae/seed-0 uav/low/full_vae/seed-0"""

Column = dict[str, Any]
"""Values of one cell by the name of the row."""


@dataclass(frozen=True, kw_only=True)
class Options(StudyOptions):
    """Options of `compare`.

    Attributes:
        cells: names of the cells.
    """

    cells: Annotated[list[str], Argument("such as pusher/low/residual_vae/seed-0")]


def run(options: Options) -> int:
    """Print the settings that differ, and the scores."""
    names = [cell.name for cell in known_cells(options)]
    for name in options.cells:
        check_cell(name, names)
    if len(set(options.cells)) < 2:
        raise BadInput(f"compare: got {options.cells[0]} alone; give two cells or more")
    results = folder.read(options.out)
    selected = [results.cell(name, "compare") for name in options.cells]
    terminal = console()
    _print(terminal, "settings that differ", different_settings(results, selected))
    _print(terminal, "scores", scores(results.out, selected))
    return 0


def different_settings(results: Results, cells: Sequence[Cell]) -> "pd.DataFrame":
    """The settings that are not the same for all cells, with a row for each and a column by cell.

    A setting that a cell's stages do not depend on is None. One row is the β from the search.
    """
    columns = {cell.name: _settings(results, cell) for cell in cells}
    table = _side_by_side(columns)
    return table[[len(set(row)) > 1 for row in table.to_numpy(dtype=object)]]


def scores(out: Path, cells: Sequence[Cell]) -> "pd.DataFrame":
    """The scores of cells, aggregated as in the tables: a row for each score, a column by cell."""
    import pandas as pd

    from paper_figs.score_tables import MEASURES, rows
    from study.metrics.intervals import Interval

    table = pd.read_parquet(out / "scores.parquet")
    columns: dict[str, Column] = {}
    for cell in cells:
        column: Column = {}
        by_metric = rows(_of_cell(table, cell), cell.environment, cell.level)
        for measure in MEASURES:
            entry = by_metric.get(measure.metric, {}).get(cell.model)
            column[measure.name] = entry.estimate if isinstance(entry, Interval) else entry
        columns[cell.name] = column
    return _side_by_side(columns).dropna(how="all")


def _settings(results: Results, cell: Cell) -> Column:
    """The environment, level, model, seed and β of a cell, and the settings of its stages."""
    import pandas as pd

    from study.workflow.pipeline import Pipeline
    from study.workflow.task_cache import topological_order

    trials = _of_cell(pd.read_parquet(results.out / "trials.parquet"), cell)
    column = asdict(cell) | {"beta": _only(trials[trials.chosen.astype(bool)], "beta")}
    for task in topological_order([Pipeline(results.config).evaluate(cell)]):
        for path, value in by_dotted_name(task.settings, f"{task.stage}.").items():
            section, name = path.split(".")[-2:]
            # The seeds of stages depend on the cell alone.
            if name not in column:
                column[f"{section}.{name}"] = value
    return column


def _of_cell(table: "pd.DataFrame", cell: Cell) -> "pd.DataFrame":
    for name, value in asdict(cell).items():
        table = table[table[name] == value]
    return table


def _only(rows: "pd.DataFrame", column: str = "value") -> float | None:
    """The value of the first row; None without rows."""
    return float(rows[column].iloc[0]) if len(rows) else None


def _side_by_side(columns: Mapping[str, Column]) -> "pd.DataFrame":
    """A table with rows in the order in which they first occur."""
    import pandas as pd

    rows = list(dict.fromkeys(name for column in columns.values() for name in column))
    table = {cell: [column.get(row) for row in rows] for cell, column in columns.items()}
    return pd.DataFrame(table, index=rows, dtype=object)


def _print(terminal: Console, title: str, frame: "pd.DataFrame") -> None:
    if frame.empty:
        terminal.print(f"{title}: none")
        return
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    table.add_column("")
    for cell in frame.columns:
        table.add_column(str(cell), justify="right", overflow="fold")
    for name, row in zip(frame.index, frame.to_numpy(dtype=object), strict=True):
        table.add_row(str(name), *map(_text, row))
    terminal.print(table)
    terminal.print()


def _text(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


COMMAND = Command(
    "compare",
    "settings that differ and scores of cells, side by side: compare CELL CELL",
    Options,
    run,
    DETAILS,
)
