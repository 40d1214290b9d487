"""A first YAML file for some logs. What the logs cannot say is marked by ``CHECK``."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from study.data.recorded.inspection import DEGREES, ColumnReport, Inspection, TableReport
from study.data.recorded.rows import SECONDS

FEWEST_TRAJECTORIES = 10
"""With fewer, long trajectories are cut into pieces."""
PIECES = 20
"""The number of pieces into which the logs are then cut."""
SHORTEST = 10
"""Steps of a piece, at least."""
WINDOWS = 4
"""Windows of the horizon in a trajectory, at least."""
LIKELY = (1e-4, 10.0)
"""A likely interval of logs, in seconds."""
HORIZON = 50
QUATERNION = re.compile(r"(\.q(_\w+)?\[\d\]|orientation\.[xyzw])$")
MOST = 12
"""State variables that are proposed, at most; the others are comments."""
TOPICS = (
    *("attitude", "angular_velocity", "local_position", "odom", "pose", "velocity", "joint"),
    *("position", "imu"),
)
"""Parts of the names of topics, the most likely source of a state first."""
SLOWEST = 10.0
"""A topic whose interval is so many times that of the likeliest one is left out of the state."""


@dataclass(frozen=True)
class Proposal:
    """The settings of a recorded system, as far as the logs show them.

    Attributes:
        state: proposed state variables.
        action: proposed action variables.
        others: further columns that vary.
        horizon: control steps T.
        step: seconds of a control step; None if no time is known.
        resample: whether the logs are resampled to `step`.
        longest: seconds; None if trajectories are not cut.
        lengths: rows of each trajectory, after resampling.
        time_unit: of a time column.
    """

    state: Sequence[ColumnReport]
    action: Sequence[ColumnReport]
    others: Sequence[ColumnReport]
    horizon: int
    step: float | None
    resample: bool
    longest: float | None
    lengths: Sequence[int]
    time_unit: str


def propose(inspection: Inspection, horizon: int | None = None) -> Proposal:
    """Settings that may be right.

    Args:
        inspection: of the logs.
        horizon: control steps T; None is chosen.
    """
    tables = sorted(inspection.tables, key=_rank)
    varying = [
        (table, column) for table in tables for column in table.of_role("state", "angle", "action")
    ]
    several = len(tables) > 1
    states: dict[str, ColumnReport] = {}
    slowest = SLOWEST * next((t.interval for t, _ in varying if t.interval is not None), np.inf)
    for table, column in varying:
        is_slow = table.interval is not None and table.interval > slowest
        is_likely = not several or (_rank(table)[0] < len(TOPICS) and not is_slow)
        if column.role != "action" and is_likely and not QUATERNION.search(column.name):
            states.setdefault(_short(column.name), column)
    state = list(states.values())[:MOST]
    commanded = [t for t in tables if t.of_role("action")]
    actuators = [t for t in commanded if "actuator" in t.name] or commanded[:1]
    source = max(actuators, key=lambda t: t.rows, default=None)
    action = source.of_role("action") if source else []
    used = {c.name for c in (*state, *action)}
    owners = [t for t in tables if used & {c.name for c in t.columns}]
    has_column = any(table.of_role("time") for table in owners)
    unit = _time_unit(owners) if has_column else "s"
    step, resample = _step(owners, SECONDS[unit])
    lengths = _lengths(owners, step if resample else None, SECONDS[unit])
    longest = None
    if step is not None and len(lengths) < FEWEST_TRAJECTORIES:
        rows = max(SHORTEST, sum(lengths) / PIECES)
        longest = float(f"{rows * step:.2g}")
    rows = round(longest / step) + 1 if longest and step else max(lengths, default=2)
    chosen = horizon or max(2, min(HORIZON, (rows - 1) // WINDOWS))
    others = [c for _, c in varying if c.name not in used]
    return Proposal(state, action, others, chosen, step, resample, longest, lengths, unit)


def to_yaml(inspection: Inspection, proposal: Proposal, name: str, patterns: Sequence[str]) -> str:
    """The text of the YAML file."""
    tables = inspection.tables
    lines = [
        "# Written by `python -m study.run inspect`. CHECK marks what the logs cannot say.",
        f"# python -m study.run all --config {name}.yaml",
        f"name: {name}",
        "grid:",
        f"  environments: [{name}]",
        "  levels: [low]",
        "  models: [full_crps, probabilistic_mlp]",
        f"{name}:",
        "  files:",
        *(f"    - {_quoted(pattern)}" for pattern in patterns),
        "  # NAME = COLUMN [UNIT]. CHECK the units and which variables are states and actions.",
        "  state:",
        *_variables(proposal.state),
        "  action:" + ("" if proposal.action else " []  # CHECK: no column looks like an action"),
        *_variables(proposal.action),
    ]
    goal = [column for table in tables for column in table.of_role("goal")]
    if goal:
        lines += ["  goal:", *_variables(goal)]
    if proposal.others:
        lines.append("  # further columns that vary:")
        lines += [f"  #   {_range(column)}" for column in proposal.others]
    constant = [c.name for t in tables for c in t.of_role("constant")]
    if constant and len(tables) == 1:
        lines.append(f"  # constant: {', '.join(constant)}")
    lines += _trajectories(tables)
    lines += _times(tables, proposal)
    angles = [_short(c.name) for c in proposal.state if c.role == "angle"]
    if angles:
        lines.append(
            f"  angles: [{', '.join(angles)}]  # CHECK: in rad, or in degrees with the unit [deg]"
        )
    lines += [
        f"  horizon: {proposal.horizon}",
        f"  stride: {max(1, proposal.horizon // 10)}",
        *_examples(proposal.state),
    ]
    return "\n".join([*lines, ""])


def _examples(state: Sequence[ColumnReport]) -> list[str]:
    """Comments that show the settings of the position and of outcomes, with the variables."""
    names = [_short(column.name) for column in state]
    lines = []
    if len(names) > 1:
        lines.append(
            f"  # position: [{names[0]}, {names[1]}]  # CHECK: two or three state variables that "
            "recordings draw in space"
        )
    if names:
        middle = f"{(state[0].low + state[0].high) / 2:.2g}"
        lines += [
            "  # outcomes:  # CHECK: what matters, the main one first",
            f"  #   - {names[0]} is large = {names[0]} > {middle} at any step",
        ]
    return lines


def _rank(table: TableReport) -> tuple[int, str]:
    for number, part in enumerate(TOPICS):
        if part in table.name:
            late = len(TOPICS) * ("setpoint" in table.name or "status" in table.name)
            return number + late, table.name
    return 3 * len(TOPICS), table.name


def _time_unit(tables: Sequence[TableReport]) -> str:
    """The unit of the time in which the logs have a likely rate."""
    intervals = [t.interval for t in tables if t.interval is not None]
    for unit, seconds in SECONDS.items():
        if intervals and LIKELY[0] <= max(intervals) * seconds <= LIKELY[1]:
            return unit
    return "s"


def _step(tables: Sequence[TableReport], seconds: float) -> tuple[float | None, bool]:
    """Seconds of a control step, and whether the logs have to be resampled to it."""
    intervals = [seconds * t.interval for t in tables if t.interval is not None]
    if not intervals:
        return None, False
    step = float(f"{max(intervals):.2g}")
    irregular = any(t.gaps or t.largest > 1.1 * (t.interval or 0) for t in tables)
    return step, irregular or len(tables) > 1


def _lengths(tables: Sequence[TableReport], step: float | None, seconds: float) -> list[int]:
    """Rows of each trajectory in the slowest table, after resampling to `step`."""
    if not tables:
        return []
    table = min(tables, key=lambda t: t.rows)
    factor = 1.0 if step is None or table.interval is None else seconds * table.interval / step
    return [int(rows * factor) for rows in table.lengths]


def _trajectories(tables: Sequence[TableReport]) -> list[str]:
    roles = {
        role: [c.name for t in tables for c in t.of_role(role)] for role in ("reset", "trajectory")
    }
    if any(table.by_format for table in tables):
        return []
    if roles["reset"]:
        return [f"  reset: {_quoted(roles['reset'][0])}"]
    if roles["trajectory"]:
        return [f"  trajectory: {_quoted(roles['trajectory'][0])}"]
    return ["  # trajectory: each file is one. CHECK: is there a column that names trajectories?"]


def _times(tables: Sequence[TableReport], proposal: Proposal) -> list[str]:
    time = [c.name for t in tables for c in t.of_role("time")]
    lines = []
    if proposal.step is None:
        lines.append("  interval: 1.0  # CHECK: seconds from one row to the next")
    elif time and len(tables) == 1:
        lines.append(f"  time: {_quoted(time[0])}")
        lines.append(f"  time_unit: {proposal.time_unit}  # CHECK")
    if proposal.resample:
        lines.append(f"  control_step: {proposal.step:g}  # CHECK: seconds")
    if any(t.gaps and t.largest > 2 * (proposal.step or 0) for t in tables):
        lines.append("  breaks: split  # the time jumps, see above")
    if proposal.longest is not None:
        lines.append(
            f"  longest_trajectory: {proposal.longest:g}  # CHECK: few logs, so these are cut into "
            "pieces, which are not independent"
        )
    return lines


def _variables(columns: Sequence[ColumnReport]) -> list[str]:
    return [f"    - {_quoted(_variable(column))}  # {_seen(column)}" for column in columns]


def _variable(column: ColumnReport) -> str:
    name = _short(column.name)
    unit = ""
    if column.role == "angle":
        unit = " [deg]" if max(-column.low, column.high) > DEGREES else " [rad]"
    return f"{column.name}{unit}" if name == column.name else f"{name} = {column.name}{unit}"


def _short(column: str) -> str:
    """A name that can stand in an expression: of a topic's field, the field."""
    last = column.rpartition(".")[2] if "." in column else column
    if (
        last.startswith(("control[", "data[", "position[", "velocity[", "effort["))
        or "." not in column
    ):
        last = last if "." in column else column
    return re.sub(r"\W+", "_", last).strip("_") or "variable"


def _seen(column: ColumnReport) -> str:
    notes = ", ".join([f"{column.low:.4g} to {column.high:.4g}", *column.notes])
    return notes + (f", {column.nonfinite} not finite" if column.nonfinite else "")


def _range(column: ColumnReport) -> str:
    return f"{column.name}: {_seen(column)}"


def _quoted(text: str) -> str:
    escaped = text.replace('"', '\\"')
    return f'"{escaped}"' if re.search(r"[^\w./-]", text) else text
