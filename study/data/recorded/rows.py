"""Rows of logs: which belong to one trajectory, follow one another and are finite."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from study.common.arrays import Array, Booleans, Doubles
from study.common.errors import BadInput, nearest, shown
from study.data.readers import read
from study.data.readers.table import Table
from study.data.recorded.description import LOG_TIME, Description

GAP = 5.0
"""Median intervals without a row that are a gap, unless `largest_gap` says otherwise."""
STEPS = 2.0
"""Control steps that are a gap, if they are longer."""
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Seconds of each unit of time."""
LARGEST = float(np.finfo(np.float32).max)
"""The largest number that data sets can hold."""
IRREGULAR = 0.1
"""Share of an interval by which rows that are not resampled may be early or late."""


@dataclass(frozen=True)
class Run:
    """Consecutive rows of a table that belong to one trajectory and have no gap.

    Attributes:
        trajectory: its name.
        time: [n] seconds.
        values: [n, C], the columns of `Log.names`.
    """

    trajectory: str
    time: Doubles
    values: Doubles


class Log:
    """One log: which table has the columns of each variable.

    Attributes:
        columns: the variables, by group: state, action and goal.
        owner: the table of each column.
        used: the tables with a column of the system.
        start: time of the first row, in seconds.

    Raises:
        BadInput: a column is missing, or topics at different rates are not resampled.
    """

    def __init__(self, path: Path, system: Description) -> None:
        self.path, self.system, self.settings = path, system, system.settings
        tables = read(path, self.settings.format)
        self.columns = {group: system.columns(group) for group in ("state", "action", "goal")}
        wanted = [(g, c.column) for g, columns in self.columns.items() for c in columns]
        owner: dict[str, Table] = {}
        for group, column in wanted:
            owner[column] = self._table(tables, column, group)
        for setting in ("trajectory", "reset", "time"):
            if (column := getattr(self.settings, setting)) is not None:
                owner[column] = self._table(tables, column, setting)
        names = {id(table): table for table in owner.values()}
        self.used = list(names.values())
        self.owner = owner
        if len(self.used) > 1 and self.settings.control_step is None:
            rates = ", ".join(table.name or "?" for table in self.used)
            raise BadInput(
                f"{path}: the columns are in {len(self.used)} topics with their own times "
                f"({rates}); give {system.name}.control_step"
            )
        self.start = min(float(self.time(table)[0]) for table in self.used)

    def _table(self, tables: Sequence[Table], column: str, setting: str) -> Table:
        for table in tables:
            if column in table.columns:
                return table
        known = [name for table in tables for name in table.columns]
        raise BadInput(
            f"{self.path}: no column '{column}' ({self.system.name}.{setting}); "
            f"{nearest(column, known)}"
        )

    def time(self, table: Table) -> Doubles:
        """The time of each row in seconds."""
        settings = self.settings
        if settings.time is not None:
            owner = self.owner[settings.time]
            if owner is table:
                return self._seconds(table, settings.time)
        if table.time is not None and settings.interval is None:
            return table.time
        if settings.interval is None:
            raise BadInput(
                f"{self.path}: it has no time column; give {self.system.name}.time or "
                f"{self.system.name}.interval"
            )
        return settings.interval * np.arange(len(table), dtype=np.float64)

    def _seconds(self, table: Table, column: str) -> Doubles:
        """A time column in seconds; dates count from the first one."""
        values = pd.Series(np.asarray(table.columns[column]))
        if not pd.api.types.is_numeric_dtype(values):
            dates = pd.to_datetime(values, errors="coerce", format="mixed", utc=True)
            if dates.notna().all():
                return np.asarray((dates - dates.iloc[0]).dt.total_seconds(), np.float64)
        return self._numbers(table, column) * SECONDS[self.settings.time_unit]

    def runs(self, table: Table) -> list[Run]:
        """The runs of a table.

        Raises:
            BadInput: names the column and the row.
        """
        names = self.names(table)
        values = np.stack([self._numbers(table, name) for name in names], axis=1)
        time, trajectory = self.time(table), self._trajectories(table)
        begins = np.flatnonzero(np.r_[True, trajectory[1:] != trajectory[:-1]])
        several = len(begins) > 1
        titles = self._titles(table, trajectory, begins) if several else [str(self.path)]
        found = []
        for title, first, end in zip(titles, begins, [*begins[1:], len(table)], strict=True):
            rows = slice(int(first), int(end))
            good = self._good(table, names, values, rows, time[rows])
            joined = self._joined(table, time[rows], rows)
            last = len(good)
            # A run ends before a row that is left out and at a gap.
            begin_run = good & np.r_[True, ~(good[:-1] & joined)] if last else good
            number = np.cumsum(begin_run) - 1
            for run in range(number[-1] + 1 if last else 0):
                selected = np.flatnonzero(good & (number == run)) + first
                found.append(Run(title, time[selected], values[selected]))
        return found

    def _titles(self, table: Table, trajectory: Array, begins: Array) -> list[str]:
        by_name = self.settings.trajectory is not None or table.trajectory is not None
        named = by_name and self.settings.reset is None
        return [
            f"{self.path}#{trajectory[first] if named else number}"
            for number, first in enumerate(begins)
        ]

    def names(self, table: Table) -> list[str]:
        """The columns of a table that are variables of the system."""
        columns = [c.column for group in self.columns.values() for c in group]
        return [name for name in dict.fromkeys(columns) if self.owner[name] is table]

    def _trajectories(self, table: Table) -> Array:
        """A value for each row that changes where a trajectory begins."""
        settings = self.settings
        keys = []
        if settings.trajectory is not None and self.owner[settings.trajectory] is table:
            keys.append(pd.factorize(np.asarray(table.columns[settings.trajectory]))[0])
        elif table.trajectory is not None:
            keys.append(np.asarray(table.trajectory))
        if settings.reset is not None and self.owner[settings.reset] is table:
            flags = self._numbers(table, settings.reset)
            keys.append(np.cumsum(flags != 0))
        if not keys:
            return np.zeros(len(table), np.int64)
        if len(keys) == 1 and settings.trajectory is not None and settings.reset is None:
            return np.asarray(table.columns[settings.trajectory])
        if len(keys) == 1:
            return keys[0]
        change = np.zeros(len(table), bool)
        for key in keys:
            change |= np.r_[False, key[1:] != key[:-1]]
        return np.cumsum(change)

    def _numbers(self, table: Table, column: str) -> Doubles:
        """A column as float64; text that is no number is an error."""
        values = np.asarray(table.columns[column])
        if values.dtype.kind in "biuf":
            return values.astype(np.float64)
        series = pd.Series(values)
        numbers = pd.to_numeric(series, errors="coerce")
        wrong = np.flatnonzero((numbers.isna() & series.notna()).to_numpy())
        if len(wrong):
            raise BadInput(
                f"{self._place(table, column, wrong[0])}: got {shown(str(series.iloc[wrong[0]]))}; "
                f"it must be a number ({len(wrong)} of {len(values)} rows are not)"
            )
        return numbers.to_numpy(np.float64)

    def _good(
        self, table: Table, names: list[str], values: Doubles, rows: slice, time: Doubles
    ) -> Booleans:
        """The rows of a trajectory that are finite and not excluded, [n]."""
        part = values[rows]
        good = np.ones(len(part), bool)
        excluded = self._excluded(names, part, time)
        actions = {column.column for column in self.columns["action"]}
        for i, name in enumerate(names):
            finite = (np.abs(part[:, i]) <= LARGEST) | excluded  # false for NaN
            if name in actions and len(finite):
                finite[-1] = True  # no state follows the last action
            if not finite.all() and self.settings.breaks == "error":
                row = int(np.flatnonzero(~finite)[0])
                raise BadInput(
                    f"{self._place(table, name, rows.start + row)}: got {part[row, i]}; it must be "
                    f"a finite 32-bit number ({int((~finite).sum())} of {len(finite)} rows of the "
                    f"trajectory are not); {self.system.name}.breaks: split leaves them out"
                )
            good &= finite
        return good & ~excluded

    def _excluded(self, names: list[str], part: Doubles, time: Doubles) -> Booleans:
        """The rows [n] of a table that the settings leave out."""
        excluded = np.zeros(len(part), bool)
        by_column = {c.column: c.name for group in self.columns.values() for c in group}
        values = {LOG_TIME: time - self.start}
        values |= {by_column[name]: part[:, i] for i, name in enumerate(names)}
        for expression in self.system.exclusions:
            if set(expression.names) <= set(values):
                excluded |= np.broadcast_to(expression.evaluate(values), excluded.shape)
            elif set(expression.names) & set(values) - {LOG_TIME}:
                raise BadInput(
                    f"{self.system.name}.exclude: '{expression.text}' uses columns of several "
                    "topics; use those of one"
                )
        return excluded

    def _joined(self, table: Table, time: Doubles, rows: slice) -> Booleans:
        """Whether each row but the first follows the row before without a gap, [n - 1]."""
        interval = np.diff(time)
        column = self.settings.time or f"{table.name}.time".strip(".")
        if len(wrong := np.flatnonzero(~(interval > 0))):
            row = rows.start + int(wrong[0]) + 1
            raise BadInput(
                f"{self._place(table, column, row)}: the time goes from {time[wrong[0]]:.9g} s to "
                f"{time[wrong[0] + 1]:.9g} s; it must increase within a trajectory"
            )
        if not len(interval):
            return np.ones(0, bool)
        median = float(np.median(interval))
        largest = self.settings.largest_gap or max(
            GAP * median, STEPS * (self.settings.control_step or 0.0)
        )
        joined = interval <= largest
        if not joined.all() and self.settings.breaks == "error":
            first = int(np.flatnonzero(~joined)[0])
            raise BadInput(
                f"{self._place(table, column, rows.start + first + 1)}: the time jumps by "
                f"{interval[first]:.4g} s, where {median:.4g} s is usual "
                f"({int((~joined).sum())} jumps); {self.system.name}.breaks: split cuts the "
                "trajectory there"
            )
        usual = interval[joined]
        if self.settings.control_step is None and len(usual):
            off = np.abs(usual - median) > IRREGULAR * median
            if off.any():
                first = int(np.flatnonzero(joined)[np.flatnonzero(off)[0]])
                raise BadInput(
                    f"{self._place(table, column, rows.start + first + 1)}: an interval of "
                    f"{interval[first]:.4g} s, where {median:.4g} s is usual; give "
                    f"{self.system.name}.control_step to resample"
                )
        return joined

    def _place(self, table: Table, column: str, row: int) -> str:
        unit = "line" if self.path.suffix.lower() == ".csv" else "row"
        return f"{self.path}: column '{column}', {unit} {row + table.first_row}"
