"""Action plans in files: an initial state, a goal and actions, in CSV or JSON.

A column is a variable of the system, in its unit (``study/envs/README.md`` lists them). The prefix
names the group, since both the state and the action of the UAV have a ``vx``:

======================  ==================================  =====================================
column                  for the UAV                         values
======================  ==================================  =====================================
``s0.NAME``             ``s0.x`` … ``s0.battery``           one: the initial state
``goal.NAME``           ``goal.target_x`` …                 one: the goal, no input of a model
``action.NAME``         ``action.vx`` … ``action.yaw_rate``  T: the action of each control step
======================  ==================================  =====================================

In CSV the first row under the header has a value in every column. In the other rows ``s0`` and
``goal`` are empty. JSON has the form
``{"s0": {"x": 0.0, …}, "goal": {…}, "action": {"vx": [0.0, …]}}``.
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
from study.data.variables import System, Variable

Columns = dict[str, list[Any]]
FORMATS = (".csv", ".json")


@dataclass(frozen=True)
class Plan:
    """What a forecast is conditioned on, and its goal, in SI units.

    Attributes:
        s0: [D] float32, the initial state.
        goal: [G] float32.
        actions: [T, A] float32.
    """

    s0: Floats
    goal: Floats
    actions: Floats


def read_plan(path: Path, system: System) -> Plan:
    """Read a plan for a system; its horizon T is at most the system's.

    Raises:
        BadInput: the file cannot be read, or its content is not a plan for the system.
    """
    try:
        if path.suffix.lower() not in FORMATS:
            raise BadInput("a plan is a .csv or a .json file")
        columns = _read_json(path) if path.suffix.lower() == ".json" else _read_csv(path)
        return _check(columns, system)
    except FileNotFoundError:
        raise BadInput(f"--file: there is no file '{path}'") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadInput(f"--file: cannot read '{path}': {error}") from None
    except BadInput as error:
        raise BadInput(f"--file: {path}: {error}") from None


def write_plan(path: Path, system: System, plan: Plan) -> None:
    """Write a plan; `read_plan` gives the same float32 numbers.

    Raises:
        BadInput: the file is neither CSV nor JSON, or cannot be written.
    """
    rows = {"s0": plan.s0[None], "goal": plan.goal[None], "action": plan.actions}
    columns = {
        # `str` of a float32 has as many digits as identify it.
        f"{group}.{variable.name}": [str(value) for value in rows[group][:, index]]
        for group, variables in _groups(system).items()
        for index, variable in enumerate(variables)
    }
    if path.suffix.lower() not in FORMATS:
        raise BadInput(f"--write: got '{path}'; it must be a .csv or a .json file")
    text = _json_text(columns) if path.suffix.lower() == ".json" else _csv_text(columns)
    try:
        write_text(path, text)
    except OSError as error:
        raise BadInput(f"--write: cannot write '{path}': {error}") from None


def _groups(system: System) -> dict[str, tuple[Variable, ...]]:
    return {"s0": system.state, "goal": system.goal, "action": system.action}


def _read_csv(path: Path) -> Columns:
    # A spreadsheet program may begin the file with a byte order mark.
    rows = list(csv.reader(StringIO(path.read_text(encoding="utf-8-sig"))))
    while rows and not any(rows[-1]):
        rows.pop()  # An empty row between two steps is an error.
    if not rows:
        raise BadInput("the file is empty")
    header = [name.strip() for name in rows[0]]
    for number, row in enumerate(rows[1:], start=1):
        if len(row) != len(header):
            raise BadInput(f"row {number} has {len(row)} cells; the header has {len(header)}")
    if repeated := [name for name in header if header.count(name) > 1]:
        raise BadInput(f"column '{repeated[0]}' appears more than once")
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
        raise BadInput(f"the file is not JSON: {error}") from None
    if not isinstance(content, dict) or not all(isinstance(v, dict) for v in content.values()):
        raise BadInput('the form must be {"s0": {…}, "goal": {…}, "action": {…}}')
    return {
        f"{group}.{name}": values if isinstance(values, list) else [values]
        for group, members in content.items()
        for name, values in members.items()
    }


def _check(columns: Columns, system: System) -> Plan:
    groups = _groups(system)
    variables = {f"{group}.{v.name}": v for group, members in groups.items() for v in members}
    missing = [name for name in variables if name not in columns]
    for name in columns:
        if name not in variables:
            raise BadInput(f"unknown column '{name}': {nearest(name, missing or variables)}")
    if missing:
        names = ", ".join(f"{n} ({variables[n].meaning}, {variables[n].unit})" for n in missing)
        raise BadInput(f"missing: {names}")
    horizon = max(len(columns[f"action.{v.name}"]) for v in system.action)
    if not 1 <= horizon <= system.horizon:
        raise BadInput(
            f"got {horizon} control steps; there must be 1 to {system.horizon}, "
            "the horizon of the training data"
        )
    counts = {"s0": 1, "goal": 1, "action": horizon}
    values = {
        group: np.array(
            [
                _numbers(f"{group}.{v.name}", columns[f"{group}.{v.name}"], v, counts[group])
                for v in members
            ],
            np.float32,
        ).reshape(len(members), counts[group])
        for group, members in groups.items()
    }
    return Plan(
        s0=values["s0"][:, 0],
        goal=values["goal"][:, 0],
        actions=np.ascontiguousarray(values["action"].T),
    )


def _numbers(name: str, values: list[Any], variable: Variable, count: int) -> list[float]:
    if len(values) != count:
        raise BadInput(f"{name}: got {len(values)} values; there must be {count}")
    return [_number(name, step, value, variable) for step, value in enumerate(values)]


def _number(name: str, step: int, value: Any, variable: Variable) -> float:
    location = f"{name}, step {step}" if name.startswith("action.") else name
    try:
        number = float("" if isinstance(value, bool) else value)
    except (TypeError, ValueError):
        raise BadInput(f"{location}: got '{value}'; it must be a number") from None
    if not np.isfinite(number):
        raise BadInput(f"{location}: got {value}; it must be a finite number")
    low, high = variable.low, variable.high
    # Compared as float32: the nearest float32 to a bound may lie beyond the bound.
    if not np.float32(low) <= np.float32(number) <= np.float32(high):
        raise BadInput(f"{location}: got {value}; it must be {low:g} to {high:g} {variable.unit}")
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
