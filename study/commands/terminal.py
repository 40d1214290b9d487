"""The terminal: the console, and a progress bar for work in this process."""

import sys

from rich.console import Console
from rich.measure import Measurement
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bars
from rich.table import Table

from study.common.progress import Progress

FILE_WIDTH = 200
"""Columns of text if the output is not a terminal, so that no table is cut off."""
NAME_WIDTH = 8
"""Columns of text of the first column of a table, at least."""


class _Console(Console):
    """Leaves a closed pipe to `study.run`, as `print` does. Rich would exit with another code."""

    def on_broken_pipe(self) -> None:
        """Raise the error again."""
        raise  # Rich calls this where it handles the error


def console() -> Console:
    """A console on the current standard output, which tests and stages may redirect."""
    width = None if sys.stdout.isatty() else FILE_WIDTH
    return _Console(file=sys.stdout, width=width, highlight=False, markup=False)


def say(to: Console, line: str) -> None:
    """Write a line of any length without line breaks."""
    to.print(line, soft_wrap=True)


def show(to: Console, table: Table) -> None:
    """Write a table. In a narrow terminal its first column wraps, and no number is cut off."""
    wide = to.options.update(max_width=FILE_WIDTH)
    name, *numbers = table.columns
    name.no_wrap, name.overflow, name.min_width = False, "fold", NAME_WIDTH
    for column in numbers:
        column.no_wrap = True
        cells = [column.header, *column.cells]
        column.min_width = max(Measurement.get(to, wide, cell).maximum for cell in cells)
    name.max_width = NAME_WIDTH
    needed = Measurement.get(to, wide, table).minimum
    name.max_width = None
    if needed > to.width:
        table.width = needed
    to.print(table, crop=False)  # what is wider than the terminal goes on in its next line


class Bar(Progress):
    """The progress of work in this process: a bar in a terminal, otherwise no output.

    Args:
        to: the terminal.
    """

    def __init__(self, to: Console) -> None:
        super().__init__()
        self._bars = Bars(
            TextColumn("{task.description}"),
            BarColumn(bar_width=30),
            TimeRemainingColumn(),
            console=to,
            disable=not to.is_terminal,
            transient=True,
        )
        self._bar = self._bars.add_task("", total=1.0)

    def __enter__(self) -> "Bar":
        self._bars.start()
        return self

    def __exit__(self, *raised: object) -> None:
        self._bars.stop()

    def _report(self, fraction: float, message: str) -> None:
        self._bars.update(self._bar, completed=fraction, description=message)
