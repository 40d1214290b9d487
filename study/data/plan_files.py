"""A plan of one's own: where a system starts, what it is to do, and its actions; CSV or JSON.

Columns have the environment's own names and units (``study/envs/README.md``), with what they are in
front, since a UAV's state and its action both have a ``vx``:

======================  ==================================  =======================================
column                  of the UAV, say                     values
======================  ==================================  =======================================
``s0.NAME``             ``s0.x`` … ``s0.battery``           one: the state at the start
``goal.NAME``           ``goal.target_x`` …                 one: what is asked for; no model sees it
``action.NAME``         ``action.vx`` … ``action.yaw_rate``  T: the action of each control step
======================  ==================================  =======================================

In CSV the first row under the header has all of them, and the rows after it leave ``s0`` and
``goal`` empty. In JSON they are ``{"s0": {"x": 0.0, …}, "goal": {…}, "action": {"vx": [0.0, …]}}``.
"""

import csv
import json
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from study.common.arrays import Floats
from study.common.errors import BadInput, nearest
from study.common.files import write_text
from study.envs.simulator import Simulator, Variable

Columns = dict[str, list[Any]]
FORMATS = (".csv", ".json")


@dataclass(frozen=True)
class Plan:
    """What a forecast begins from: s0 [D], goal [G] and actions [T, A], float32 in SI units."""

    s0: Floats
    goal: Floats
    actions: Floats


def read_plan(path: Path, simulator: Simulator) -> Plan:
    """Read a plan for an environment; its horizon T is at most the simulator's.

    Raises:
        BadInput: whatever is wrong with the file, in one line.
    """
    try:
        if path.suffix.lower() not in FORMATS:
            raise BadInput("a plan is a .csv or a .json file")
        columns = _read_json(path) if path.suffix.lower() == ".json" else _read_csv(path)
        return _checked(columns, simulator)
    except FileNotFoundError:
        raise BadInput(f"--file: there is no file '{path}'") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadInput(f"--file: cannot read '{path}': {error}") from None
    except BadInput as error:
        raise BadInput(f"--file: {path}: {error}") from None


def write_plan(path: Path, simulator: Simulator, plan: Plan) -> None:
    """Write a plan that `read_plan` reads to the same bits.

    Raises:
        BadInput: the file is neither CSV nor JSON, or cannot be written.
    """
    rows = {"s0": plan.s0[None], "goal": plan.goal[None], "action": plan.actions}
    columns = {
        # The shortest digits that give the same float32.
        f"{group}.{variable.name}": [str(value) for value in rows[group][:, index]]
        for group, variables in _groups(simulator).items()
        for index, variable in enumerate(variables)
    }
    if path.suffix.lower() not in FORMATS:
        raise BadInput(f"--write: got '{path}'; it must be a .csv or a .json file")
    text = _json_text(columns) if path.suffix.lower() == ".json" else _csv_text(columns)
    try:
        write_text(path, text)
    except OSError as error:
        raise BadInput(f"--write: cannot write '{path}': {error}") from None


def _groups(simulator: Simulator) -> dict[str, tuple[Variable, ...]]:
    return {"s0": simulator.state, "goal": simulator.goal, "action": simulator.action}


def _read_csv(path: Path) -> Columns:
    # A spreadsheet may begin the file with a byte order mark.
    rows = list(csv.reader(StringIO(path.read_text(encoding="utf-8-sig"))))
    while rows and not any(rows[-1]):
        rows.pop()  # after the last step only: in between, a step would be lost
    if not rows:
        raise BadInput("it is empty")
    header = [name.strip() for name in rows[0]]
    for number, row in enumerate(rows[1:], start=1):
        if len(row) != len(header):
            raise BadInput(f"row {number} has {len(row)} cells; the header has {len(header)}")
    twice = [name for name in header if header.count(name) > 1]
    if twice:
        raise BadInput(f"column '{twice[0]}' stands there twice")
    columns: Columns = {}
    for index, name in enumerate(header):
        cells = [row[index].strip() for row in rows[1:]]
        while cells and not cells[-1]:
            cells.pop()
        columns[name] = cells
    return columns


def _read_json(path: Path) -> Columns:
    try:
        content = json.loads(path.read_text(encoding="utf-8-sig"))
    except ValueError as error:
        raise BadInput(f"it is not JSON: {error}") from None
    if not isinstance(content, dict) or not all(isinstance(v, dict) for v in content.values()):
        raise BadInput('it must be of the form {"s0": {…}, "goal": {…}, "action": {…}}')
    return {
        f"{group}.{name}": values if isinstance(values, list) else [values]
        for group, members in content.items()
        for name, values in members.items()
    }


def _checked(columns: Columns, simulator: Simulator) -> Plan:
    groups = _groups(simulator)
    variables = {f"{group}.{v.name}": v for group, each in groups.items() for v in each}
    missing = [name for name in variables if name not in columns]
    for name in columns:
        if name not in variables:
            raise BadInput(f"unknown column '{name}': {nearest(name, missing or variables)}")
    if missing:
        wanted = ", ".join(f"{n} ({variables[n].meaning}, {variables[n].unit})" for n in missing)
        raise BadInput(f"missing: {wanted}")
    horizon = max(len(columns[f"action.{v.name}"]) for v in simulator.action)
    if not 1 <= horizon <= simulator.horizon:
        raise BadInput(
            f"got {horizon} control steps; there must be 1 to {simulator.horizon}, "
            "the horizon that the models were fitted on"
        )
    parts = {
        group: [
            _numbers(
                f"{group}.{v.name}",
                columns[f"{group}.{v.name}"],
                v,
                horizon if group == "action" else 1,
            )
            for v in each
        ]
        for group, each in groups.items()
    }
    return Plan(
        s0=np.array(parts["s0"], np.float32)[:, 0],
        goal=np.array(parts["goal"], np.float32)[:, 0],
        actions=np.ascontiguousarray(np.array(parts["action"], np.float32).T),
    )


def _numbers(name: str, values: list[Any], variable: Variable, count: int) -> list[float]:
    if len(values) != count:
        raise BadInput(f"{name}: got {len(values)} values; it takes {count}")
    return [_number(name, step, value, variable) for step, value in enumerate(values)]


def _number(name: str, step: int, value: Any, variable: Variable) -> float:
    at = f"{name}, step {step}" if name.startswith("action.") else name
    try:
        number = float("" if isinstance(value, bool) else value)
    except (TypeError, ValueError):
        raise BadInput(f"{at}: got '{value}'; it must be a number") from None
    if not np.isfinite(number):
        raise BadInput(f"{at}: got {value}; it must be a finite number")
    low, high = variable.low, variable.high
    # As float32, in which they are used: its nearest number to a bound may lie beyond it.
    if not np.float32(low) <= np.float32(number) <= np.float32(high):
        raise BadInput(f"{at}: got {value}; it must be {low:g} to {high:g} {variable.unit}")
    return number


def _csv_text(columns: Columns) -> str:
    length = max(map(len, columns.values()))
    padded = [values + [""] * (length - len(values)) for values in columns.values()]
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*padded, strict=True))
    return text.getvalue()


def _json_text(columns: Columns) -> str:
    content: dict[str, dict[str, Any]] = {}
    for column, values in columns.items():
        group, name = column.split(".", 1)
        numbers = [float(value) for value in values]
        content.setdefault(group, {})[name] = numbers if group == "action" else numbers[0]
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"
