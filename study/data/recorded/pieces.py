"""Trajectories of logs: rows that follow one another without a gap, at regular steps."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from study.common.arrays import Array, Booleans, Doubles, Floats
from study.common.errors import BadInput, nearest, shown
from study.data.readers import read
from study.data.readers.table import Table
from study.data.recorded.description import LOG_TIME, Description
from study.data.recorded.resampling import grid, interpolate, mean_of_steps, previous

GAP = 5.0
"""Median intervals without a row that are a gap, unless the setting `largest_gap` says otherwise."""
STEPS = 2.0
"""Control steps that are a gap, if they are longer."""
IRREGULAR = 0.1
"""Share of an interval by which rows that are not resampled may be early or late."""


@dataclass(frozen=True)
class Piece:
    """A part of a trajectory without gaps.

    Attributes:
        trajectory: its name; a split keeps all pieces of a trajectory together.
        states: [n, D] float32.
        actions: [n, A] float32; the last one leads nowhere.
        goal: [n, G] float32.
    """

    trajectory: str
    states: Floats
    actions: Floats
    goal: Floats

    def __len__(self) -> int:
        return len(self.states)

    @property
    def digest(self) -> bytes:
        """A hash of its numbers, to find copies."""
        digest = hashlib.sha256(np.ascontiguousarray(self.states).data)
        digest.update(np.ascontiguousarray(self.actions[:-1]).data)
        return digest.digest()


@dataclass(frozen=True)
class _Run:
    """Consecutive rows of a table that belong to one trajectory and have no gap."""

    trajectory: str
    time: Doubles
    values: Doubles


def pieces_of(path: Path, system: Description) -> Iterator[Piece]:
    """The pieces of a log, in its order.

    Raises:
        BadInput: names the file, the column and the row.
    """
    log = _Log(path, system)
    runs = [log.runs(table) for table in log.used]
    spans = _common(runs) if len(runs) > 1 else [(run,) for run in runs[0]]
    for span in spans:
        yield from log.pieces(span)


def control_step(system: Description, paths: Sequence[Path]) -> float:
    """Seconds between the states of a trajectory, from the settings or from the first log."""
    settings = system.settings
    if settings.control_step is not None:
        return settings.control_step
    log = _Log(paths[0], system)
    time = log.time(log.used[0])
    return float(settings.interval or np.median(np.diff(time)[np.diff(time) > 0]))


class _Log:
    """One log: which table has the columns of each variable."""

    def __init__(self, path: Path, system: Description) -> None:
        self.path, self.system, self.settings = path, system, system.settings
        tables = read(path, self.settings.format)
        self.columns = {
            group: system.columns(group) for group in ("state", "action", "goal")
        }
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
                return self._numbers(table, settings.time)
        if table.time is not None and settings.interval is None:
            return table.time
        if settings.interval is None:
            raise BadInput(
                f"{self.path}: it has no time column; give {self.system.name}.time or "
                f"{self.system.name}.interval"
            )
        return settings.interval * np.arange(len(table), dtype=np.float64)

    def runs(self, table: Table) -> list[_Run]:
        """The runs of a table; the columns of its values are in the order of `_names`."""
        names = self._names(table)
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
                found.append(_Run(title, time[selected], values[selected]))
        return found

    def _titles(self, table: Table, trajectory: Array, begins: Array) -> list[str]:
        by_name = self.settings.trajectory is not None or table.trajectory is not None
        named = by_name and self.settings.reset is None
        return [
            f"{self.path}#{trajectory[first] if named else number}"
            for number, first in enumerate(begins)
        ]

    def _names(self, table: Table) -> list[str]:
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
            finite = np.isfinite(part[:, i]) | excluded
            if name in actions and len(finite):
                finite[-1] = True  # no state follows the last action
            if not finite.all() and self.settings.breaks == "error":
                row = int(np.flatnonzero(~finite)[0])
                raise BadInput(
                    f"{self._place(table, name, rows.start + row)}: got {part[row, i]}; it must be "
                    f"finite ({int((~finite).sum())} of {len(finite)} rows of the trajectory are "
                    f"not); {self.system.name}.breaks: split leaves them out"
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

    def pieces(self, span: Sequence[_Run]) -> Iterator[Piece]:
        """The pieces of runs that overlap in time, one run for each table."""
        step, first = self.settings.control_step, max(run.time[0] for run in span)
        at = None
        if step is not None:
            at = grid(first, min(run.time[-1] for run in span), step)
        values = {
            group: self._group(group, span, at) for group in ("state", "action", "goal")
        }
        states = self._with_angles(values["state"]).astype(np.float32)
        actions, goal = (values[g].astype(np.float32) for g in ("action", "goal"))
        length = len(states)
        longest = self.settings.longest_trajectory
        if longest is None:
            yield Piece(span[0].trajectory, states, actions, goal)
            return
        seconds = step or self.settings.interval or float(np.median(np.diff(span[0].time)))
        rows = max(2, round(longest / seconds) + 1)
        for start in range(0, length - 1, rows):
            part = slice(start, start + rows)
            title = f"{span[0].trajectory} from {start * seconds + first:.6g} s"
            yield Piece(title, states[part], actions[part], goal[part])

    def _group(self, group: str, span: Sequence[_Run], at: Doubles | None) -> Doubles:
        """The variables of a group [n, V], at the times `at` or in the rows of the log."""
        found = []
        angles = self.settings.angles if group == "state" else ()
        for column in self.columns[group]:
            index = self.used.index(self.owner[column.column])
            run = span[index]
            values = run.values[:, [self._names(self.used[index]).index(column.column)]]
            if column.name in angles:
                values = np.unwrap(values, axis=0)
            if at is not None and group == "state":
                values = interpolate(run.time, values, at)
            elif at is not None and group == "action":
                values = mean_of_steps(run.time, _without_nan(values), at)
            elif at is not None:
                values = previous(run.time, values, at)
            found.append(values)
        rows = len(at) if at is not None else len(span[0].values)
        return np.concatenate(found, axis=1) if found else np.empty((rows, 0))

    def _with_angles(self, values: Doubles) -> Doubles:
        """The states, with the sine and cosine of angles if the settings say so."""
        if self.settings.angles_as != "sine_cosine":
            return values
        parts = []
        for i, column in enumerate(self.columns["state"]):
            value = values[:, [i]]
            is_angle = column.name in self.settings.angles
            parts += [np.sin(value), np.cos(value)] if is_angle else [value]
        return np.concatenate(parts, axis=1)


def _without_nan(values: Doubles) -> Doubles:
    """The values with that of the row before in place of a last one that is not finite."""
    if len(values) > 1 and not np.isfinite(values[-1]).all():
        values = values.copy()
        values[-1] = values[-2]
    return values


def _common(runs: Sequence[Sequence[_Run]]) -> list[tuple[_Run, ...]]:
    """The combinations of runs, one of each table, that overlap in time."""
    spans: list[tuple[_Run, ...]] = [()]
    for of_table in runs:
        spans = [
            (*span, run)
            for span in spans
            for run in of_table
            if _overlap((*span, run))
        ]
    return [tuple(map(lambda run: run, span)) for span in spans]


def _overlap(span: tuple[_Run, ...]) -> bool:
    return max(run.time[0] for run in span) < min(run.time[-1] for run in span)


Tables = Mapping[str, Table]
