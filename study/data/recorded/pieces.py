"""Trajectories of logs: rows that follow one another without a gap, at regular steps."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from study.common.arrays import Doubles, Floats
from study.common.errors import BadInput
from study.data.recorded.description import Description
from study.data.recorded.resampling import grid, interpolate, mean_of_steps, previous
from study.data.recorded.rows import Log, Run

FINEST = 100
"""Control steps for each row of a log, at most: more would repeat the same numbers."""


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

    def digest(self, rows: int) -> bytes:
        """A hash of the numbers of its first rows, to find copies."""
        digest = hashlib.sha256(np.ascontiguousarray(self.states[:rows]).data)
        digest.update(np.ascontiguousarray(self.actions[: rows - 1]).data)
        return digest.digest()


def pieces_of(path: Path, system: Description) -> Iterator[Piece]:
    """The pieces of a log, in its order.

    Raises:
        BadInput: names the file, the column and the row.
    """
    log = Log(path, system)
    # Runs of several topics belong together where they overlap in time.
    for span in product(*(log.runs(table) for table in log.used)):
        if len(span) == 1 or _overlap(span):
            yield from _pieces(log, span)


def control_step(system: Description, paths: Sequence[Path]) -> float:
    """Seconds between the states of a trajectory, from the settings or from the first log."""
    settings = system.settings
    if settings.control_step is not None:
        return settings.control_step
    log = Log(paths[0], system)
    interval = np.diff(log.time(log.used[0]))
    return float(settings.interval or np.median(interval[interval > 0]))


def _overlap(span: Sequence[Run]) -> bool:
    return max(run.time[0] for run in span) < min(run.time[-1] for run in span)


def _pieces(log: Log, span: Sequence[Run]) -> Iterator[Piece]:
    """The pieces of runs that overlap in time, one run for each table.

    Raises:
        BadInput: the control step is far shorter than the interval of the rows.
    """
    step, first = log.settings.control_step, max(run.time[0] for run in span)
    at = None
    if step is not None:
        last = min(run.time[-1] for run in span)
        logged = max(len(run.time) for run in span)
        if last - first > FINEST * logged * step:
            raise BadInput(
                f"{log.system.name}.control_step: got {step:g}; {log.path} has {logged} rows in "
                f"{last - first:.4g} s; give a longer control step"
            )
        at = grid(first, last, step)
    values = {group: _group(log, group, span, at) for group in ("state", "action", "goal")}
    states = _with_angles(log, values["state"]).astype(np.float32)
    actions, goal = (values[g].astype(np.float32) for g in ("action", "goal"))
    length = len(states)
    longest = log.settings.longest_trajectory
    if longest is None:
        yield Piece(span[0].trajectory, states, actions, goal)
        return
    seconds = step or log.settings.interval or float(np.median(np.diff(span[0].time)))
    rows = max(2, round(longest / seconds) + 1)
    for start in range(0, length - 1, rows):
        part = slice(start, start + rows)
        title = f"{span[0].trajectory} from {start * seconds + first:.6g} s"
        yield Piece(title, states[part], actions[part], goal[part])


def _group(log: Log, group: str, span: Sequence[Run], at: Doubles | None) -> Doubles:
    """The variables of a group [n, V], at the times `at` or in the rows of the log."""
    found = []
    angles = log.settings.angles if group == "state" else ()
    for column in log.columns[group]:
        index = log.used.index(log.owner[column.column])
        run = span[index]
        values = run.values[:, [log.names(log.used[index]).index(column.column)]]
        if column.name in angles:
            values = np.unwrap(np.radians(values) if column.in_degrees else values, axis=0)
        if at is not None and group == "state":
            values = interpolate(run.time, values, at)
        elif at is not None and group == "action":
            values = mean_of_steps(run.time, _without_nan(values), at)
        elif at is not None:
            values = previous(run.time, values, at)
        found.append(values)
    rows = len(at) if at is not None else len(span[0].values)
    return np.concatenate(found, axis=1) if found else np.empty((rows, 0))


def _with_angles(log: Log, values: Doubles) -> Doubles:
    """The states, with the sine and cosine of angles if the settings say so."""
    if log.settings.angles_as != "sine_cosine":
        return values
    parts: list[Doubles] = []
    for i, column in enumerate(log.columns["state"]):
        value = values[:, [i]]
        is_angle = column.name in log.settings.angles
        parts += [np.sin(value), np.cos(value)] if is_angle else [value]
    return np.concatenate(parts, axis=1)


def _without_nan(values: Doubles) -> Doubles:
    """The values with that of the row before in place of a last one that is not finite."""
    if len(values) > 1 and not np.isfinite(values[-1]).all():
        values = values.copy()
        values[-1] = values[-2]
    return values
