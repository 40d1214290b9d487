"""What can be seen in logs: ranges, rates, gaps, resets, and columns that look like angles."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from study.common.arrays import Array, Doubles
from study.common.counts import counted
from study.common.errors import shown
from study.data.readers import read
from study.data.readers.table import Table
from study.data.recorded.rows import GAP

ANGLE = re.compile(
    r"(theta|angle|roll|pitch|yaw|heading|phi|psi|azimuth|orientation)(_?\d+|_rad|_deg)?$", re.I
)
ACTION = re.compile(
    r"(action|torque|cmd|command|control|setpoint|input|throttle|force|motor|effort|steer|brake)"
    r"|^u_?\d*$",
    re.I,
)
ACTION_TOPIC = re.compile(r"(action|actuator|cmd|command|setpoint)", re.I)
TIME = re.compile(r"(^|[._])(t|time|timestamp|stamp|ts|seconds|sec)$|_ts$|fake_ts", re.I)
TRAJECTORY = re.compile(
    r"(episode|traj|trajectory|run|flight|rollout|trial)(_?(id|index|no))?$", re.I
)
NO_STATE = re.compile(
    r"(reward|return|done|terminat|truncat|epoch|index|label|valid|counter|timestamp|status|flag"
    r"|armed|utc|jamming|variance|[._](eph|epv|dt|dist_bottom\w*|\w*_dt|\w*covariance\w*)(\[\d+\])*$|innov|inconsistency)",
    re.I,
)
SINE = re.compile(r"(sin|cos)", re.I)
GOAL = "goal."
"""Begins the columns of the goal in data sets that `export` wrote."""
SHORTEST = 1e-4
"""Dates closer than so many seconds are no times."""
DEGREES = 20.0
"""An angle beyond this is not in rad, unless it was unwrapped over several turns."""
LISTED = 12
"""Problems that are listed, at most."""


@dataclass(frozen=True)
class ColumnReport:
    """What can be seen of a column.

    Attributes:
        name: of the column.
        low: smallest finite value; NaN for text.
        high: largest finite value.
        nonfinite: rows that are empty or not finite; text does not count.
        role: what it looks like: state, action, goal, angle, time, trajectory, reset, constant,
            text or other.
        notes: what a reader should know.
    """

    name: str
    low: float
    high: float
    nonfinite: int
    role: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class TableReport:
    """What can be seen of the tables of one topic, or of all files without topics.

    Attributes:
        name: of the topic; empty without topics.
        rows: of all files.
        interval: median seconds between rows; None without a time.
        gaps: number of intervals longer than five medians.
        largest: longest interval in seconds.
        backwards: number of rows whose time does not increase.
        columns: its columns.
        lengths: rows of each trajectory.
        by_format: whether the format says where trajectories begin.
    """

    name: str
    rows: int
    interval: float | None
    gaps: int
    largest: float
    backwards: int
    columns: tuple[ColumnReport, ...]
    lengths: tuple[int, ...]
    by_format: bool = False

    def of_role(self, *roles: str) -> list[ColumnReport]:
        """The columns that look like one of some roles."""
        return [column for column in self.columns if column.role in roles]


@dataclass(frozen=True)
class Inspection:
    """What can be seen of some logs.

    Attributes:
        files: the logs.
        tables: a report for each topic.
        problems: what keeps a log from being used, in a line each.
    """

    files: Sequence[Path]
    tables: Sequence[TableReport]
    problems: Sequence[str] = field(default_factory=tuple)


def inspect(files: Sequence[Path]) -> Inspection:
    """Look at logs with the same columns.

    Raises:
        BadInput: a log cannot be read.
    """
    by_topic: dict[str, dict[Path, Table]] = {}
    for path in files:
        for table in read(path):
            by_topic.setdefault(table.name, {})[path] = table
    reports = [_table_report(name, list(tables.values())) for name, tables in by_topic.items()]
    return Inspection(files, reports, _missing(files, by_topic))


def _missing(files: Sequence[Path], by_topic: Mapping[str, Mapping[Path, Table]]) -> list[str]:
    """A line for each topic, and each column of a topic, that is not in all files."""
    lacking: list[tuple[str, list[Path]]] = []
    for topic, tables in by_topic.items():
        names = dict.fromkeys(name for table in tables.values() for name in table.columns)
        what = f"topic '{topic}'" if topic else f"column '{next(iter(names))}'"
        lacking.append((what, [path for path in files if path not in tables]))
        for name in names:
            without = [path for path, table in tables.items() if name not in table.columns]
            lacking.append((f"column '{name}'", without))
    count = counted(len(files), "file")
    lines = [
        f"{len(without)} of {count} lack {what}: {without[0]}{' and others' * (len(without) > 1)}"
        for what, without in lacking
        if without
    ]
    more = len(lines) - LISTED
    return [*lines[:LISTED], *[f"… and {counted(more, 'more line')} like these"] * (more > 0)]


def _table_report(name: str, tables: Sequence[Table]) -> TableReport:
    columns = [
        _column_report(column, [t.columns[column] for t in tables if column in t.columns])
        for column in dict.fromkeys(c for table in tables for c in table.columns)
    ]
    reset = next((c.name for c in columns if c.role == "reset"), None)
    trajectory = next((c.name for c in columns if c.role == "trajectory"), None)
    lengths: list[int] = []
    intervals: list[Doubles] = []
    time = next((c.name for c in columns if c.role == "time"), None)
    for table in tables:
        begins = _begins(table, reset, trajectory)
        lengths += np.diff([*np.flatnonzero(begins), len(table)]).tolist()
        seconds = table.time
        if seconds is None and time is not None and time in table.columns:
            column = np.asarray(table.columns[time])
            seconds = column.astype(np.float64) if column.dtype.kind in "biuf" else dates(column)
        if seconds is not None and len(seconds) > 1:
            intervals.append(np.diff(seconds)[~begins[1:]])
    every = np.concatenate(intervals) if intervals else np.empty(0)
    forward = every[every > 0]
    median = float(np.median(forward)) if len(forward) else None
    return TableReport(
        name,
        sum(map(len, tables)),
        median,
        int((forward > GAP * median).sum()) if median else 0,
        float(forward.max(initial=0.0)),
        int((every <= 0).sum()),
        tuple(columns),
        tuple(lengths),
        any(table.trajectory is not None for table in tables),
    )


def _begins(table: Table, reset: str | None, trajectory: str | None) -> Array:
    begins = np.zeros(len(table), bool)
    begins[0] = True
    if reset is not None and reset in table.columns:
        begins |= np.asarray(table.columns[reset], np.float64) != 0
    keys = [table.trajectory] if table.trajectory is not None else []
    if not keys and trajectory is not None and reset is None and trajectory in table.columns:
        keys = [table.columns[trajectory]]
    for key in keys:
        values = np.asarray(key)
        begins[1:] |= values[1:] != values[:-1]
    return begins


def _column_report(name: str, parts: Sequence[Array]) -> ColumnReport:
    values = np.concatenate([np.asarray(part) for part in parts])
    text: list[str] = []
    if values.dtype.kind not in "biuf":
        numbers = pd.to_numeric(pd.Series(values), errors="coerce").to_numpy(np.float64)
        if np.isnan(numbers).mean() > 0.5:
            if (seconds := dates(values)) is not None:
                return _date_report(name, seconds)
            return ColumnReport(name, np.nan, np.nan, 0, "text", ("text, no numbers",))
        text = [str(value) for value in values[np.isnan(numbers) & ~pd.isna(values)]]
        values = numbers
    values = values.astype(np.float64)
    finite = np.isfinite(values)
    good = values[finite]
    if not len(good):
        return ColumnReport(name, np.nan, np.nan, len(values), "other", ("no finite value",))
    low, high = float(good.min()), float(good.max())
    role, notes = _role(name, good, low, high)
    if text:
        notes.append(f"CHECK: text in {counted(len(text), 'row')}, such as {shown(text[0])}")
    return ColumnReport(name, low, high, int((~finite).sum()) - len(text), role, tuple(notes))


def dates(values: Array) -> Doubles | None:
    """The seconds [N] since the first of a column of dates; None if it has none."""
    found = pd.to_datetime(pd.Series(values), errors="coerce", format="mixed", utc=True)
    if not found.notna().all():
        return None
    return np.asarray((found - found.iloc[0]).dt.total_seconds(), np.float64)


def _date_report(name: str, seconds: Doubles) -> ColumnReport:
    """A column of dates; as a time only if its rate is likely."""
    interval = np.diff(seconds)
    is_time = len(interval) > 0 and float(np.median(interval)) >= SHORTEST
    note = "dates" if is_time else "dates that are too close to be times"
    role = "time" if is_time else "other"
    return ColumnReport(name, float(seconds.min()), float(seconds.max()), 0, role, (note,))


def _role(name: str, values: Doubles, low: float, high: float) -> tuple[str, list[str]]:
    """What a column looks like, and notes."""
    last = re.sub(r"\[\d+\]$", "", name).rpartition(".")[2]
    distinct = np.unique(values[:5000])
    if low == high:
        return "constant", [f"always {low:g}"]
    if TIME.search(last) and (np.diff(values) > 0).mean() > 0.9:
        return "time", []
    is_flag = len(distinct) <= 2 and set(distinct) <= {0.0, 1.0}
    if is_flag and 0 < (values != 0).mean() < 0.1 and values[0] != 0:
        return "reset", [
            f"not zero in {counted(int((values != 0).sum()), 'row')}: trajectories may begin there"
        ]
    whole = bool((values == np.round(values)).all())
    if whole and TRAJECTORY.search(last) and (np.diff(values) != 0).mean() < 0.5:
        return "trajectory", [counted(len(np.unique(values)), "value")]
    if name.startswith(GOAL):
        return "goal", []
    if NO_STATE.search(name):
        return "other", ["looks like no part of the state"]
    topic = name.rpartition(".")[0]
    if ACTION_TOPIC.search(topic) if topic else ACTION.search(name):
        return "action", []
    if _is_angle(last, values, low, high):
        notes = ["looks like an angle"]
        if max(abs(low), abs(high)) > DEGREES:
            notes.append("CHECK: beyond 20, so it may be in degrees")
        return "angle", notes
    return "state", []


def _is_angle(name: str, values: Doubles, low: float, high: float) -> bool:
    """Whether a column jumps by whole turns, or has the name of an angle and is in range."""
    if SINE.match(name):
        return False
    jumps = np.abs(np.diff(values))
    jumps_turn = (np.abs(jumps - 2 * np.pi) < 1.0).any() and -np.pi - 0.01 <= low and high < 6.3
    return bool(jumps_turn or (ANGLE.search(name) and high - low < 400))
