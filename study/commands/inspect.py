"""Command `inspect`: look at logs, and write a first configuration for them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from rich.box import SIMPLE
from rich.table import Table

from study.commands.command import Argument, Command, Flag
from study.commands.terminal import console, say, show
from study.common.counts import counted
from study.common.errors import BadInput
from study.common.files import why_not_writable, write_text
from study.data.recorded.inspection import TableReport

DETAILS = """\
Reads CSV, Parquet, Minari, LeRobot, PX4 ULog (pip install -e '.[ulog]'), ROS bags and MCAP
(pip install -e '.[ros]'). The file that it writes has the mark CHECK where the logs cannot say what
is right. study/data/README.md explains every setting.

examples
  python -m study.run inspect 'logs/*.csv'
  python -m study.run inspect flight.ulg --write my_robot.yaml"""

MOST_COLUMNS = 60
"""Columns of a table that are printed, at most."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of `inspect`.

    Attributes:
        files: paths or patterns of logs.
        write: the YAML file to write; None prints it.
        horizon: control steps of a window; None is chosen.
    """

    files: Annotated[list[str], Argument("logs, or patterns such as 'logs/*.csv'")]
    write: Annotated[Path | None, Flag("write the configuration to this YAML file")] = None
    horizon: Annotated[
        int | None, Flag("control steps of a window, at least 2; chosen by default")
    ] = None


def run(options: Options) -> int:
    """Print what can be seen in the logs, and write or print the configuration."""
    from study.data.readers import digests, files_of
    from study.data.recorded.inspection import inspect
    from study.data.recorded.proposal import propose, to_yaml

    if options.horizon is not None and options.horizon < 2:
        raise BadInput(f"--horizon: got {options.horizon}; give at least 2 steps")
    name = "my_robot"
    if options.write is not None:
        name = _check_target(options.write)
    files = files_of(tuple(options.files), "inspect")
    digests(files)
    inspection = inspect(files)
    terminal = console()
    rows = sum(table.rows for table in inspection.tables)
    tables = counted(len(inspection.tables), "table")
    say(terminal, f"{counted(len(files), 'log')}, {counted(rows, 'row')} in {tables}")
    for table in inspection.tables:
        if not table.name or len(table.of_role("constant")) < len(table.columns):
            show(terminal, _columns(table))
            say(terminal, _facts(table))
    for problem in inspection.problems:
        say(terminal, f"CHECK: {problem}")
    proposal = propose(inspection, options.horizon)
    stride = max(1, proposal.horizon // 10)
    length = proposal.lengths
    if proposal.longest and proposal.step:
        piece = round(proposal.longest / proposal.step) + 1
        length = [n for rows in length for n in [piece] * (rows // piece)]
    windows = sum(max(0, (n - proposal.horizon - 1) // stride + 1) for n in length)
    say(
        terminal,
        f"\n{counted(len(length), 'trajectory')}; {counted(windows, 'window')} of "
        f"{counted(proposal.horizon, 'step')}, one every {counted(stride, 'step')}",
    )
    text = to_yaml(inspection, proposal, name, list(dict.fromkeys(options.files)))
    if options.write is None:
        print(f"\n{text}")
        return 0
    write_text(options.write, text)
    print(options.write)
    return 0


def _check_target(path: Path) -> str:
    """Check that the configuration can be written.

    Returns:
        the name of the system: that of the file.

    Raises:
        BadInput: it exists, is no YAML file, or cannot be written; or its name cannot be used.
    """
    from study.common.registry import check_name

    if path.suffix not in (".yaml", ".yml"):
        raise BadInput(f"--write: got '{path}'; it must be a .yaml file")
    if path.exists():
        raise BadInput(f"--write: '{path}' exists; remove it or give another name")
    if not path.parent.exists():
        raise BadInput(f"--write: the folder '{path.parent}' does not exist; create it first")
    if problem := why_not_writable(path.parent):
        raise BadInput(f"--write: {problem}")
    check_name("recorded system", path.stem, "--write")
    return path.stem


def _columns(report: TableReport) -> Table:
    """A table with a row for each column."""
    title = report.name or "columns"
    table = Table(
        title=title, box=SIMPLE, pad_edge=False, padding=(0, 1, 0, 0), title_justify="left"
    )
    for header in ("column", "looks like"):
        table.add_column(header)
    for header in ("low", "high", "not finite"):
        table.add_column(header, justify="right")
    table.add_column("notes")
    shown = [c for c in report.columns if not report.name or c.role != "constant"]
    for column in shown[:MOST_COLUMNS]:
        numbers = (f"{column.low:.4g}", f"{column.high:.4g}", str(column.nonfinite or ""))
        table.add_row(column.name, column.role, *numbers, "; ".join(column.notes))
    return table


def _facts(report: TableReport) -> str:
    """A line about the rows and the time of a table."""
    parts = [counted(report.rows, "row")]
    if report.name and (constant := len(report.of_role("constant"))):
        parts.append(counted(constant, "constant column"))
    count = len(report.lengths)
    if count > 1:
        shortest, longest = min(report.lengths), max(report.lengths)
        lengths = f"{shortest} to {longest}" if shortest < longest else f"{longest}"
        parts.append(f"{count} trajectories of {lengths} rows")
    if report.interval is None:
        parts.append("no time")
    else:
        parts.append(f"every {report.interval:.4g} s ({1 / report.interval:.4g} Hz)")
        parts.append(f"{counted(report.gaps, 'gap')}, the longest interval {report.largest:.4g} s")
    if report.backwards:
        backwards = counted(report.backwards, "row")
        parts.append(f"CHECK: in {backwards} the time does not increase")
    return ", ".join(parts)


COMMAND = Command(
    "inspect", "look at logs and write a first configuration for them", Options, run, DETAILS
)
