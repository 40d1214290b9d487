"""Plans in files: they are read as they were written, and an error in a file is one line."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from study.common.errors import BadInput
from study.data.plan_files import Plan, read_plan, write_plan
from study.examples.cart import Cart

Columns = dict[str, dict[str, object]]
Change = Callable[[Columns], object]


def columns_of_the_cart() -> Columns:
    """A plan of four steps."""
    return {
        "s0": {"x": 0.5, "v": -0.25},
        "goal": {"target": 1.0},
        "action": {"force": [0.1, 0.2, -1.0, 1.0]},
    }


def remove(group: str, name: str) -> Change:
    return lambda columns: columns[group].pop(name)


def put(group: str, name: str, value: object) -> Change:
    return lambda columns: columns.setdefault(group, {}).update({name: value})


MISTAKES = [
    (remove("s0", "v"), "missing: s0.v (velocity, m/s)"),
    (remove("action", "force"), "missing: action.force (push, N)"),
    (put("goal", "taget", 0.0), "unknown column 'goal.taget'"),
    (put("goal", "x", 0.0), "unknown column 'goal.x'"),
    (put("s0", "x", [0.0, 1.0]), "s0.x: got 2 values; there must be 1"),
    (put("s0", "x", []), "s0.x: got 0 values; there must be 1"),
    (put("action", "force", []), "got 0 control steps; there must be 1 to 20"),
    (put("action", "force", [0.0] * 21), "got 21 control steps; there must be 1 to 20"),
    (put("action", "force", [0.0, 1.5]), "action.force, step 1: got 1.5; it must be -1 to 1 N"),
    (put("action", "force", [0.0, float("nan")]), "step 1: got nan; it must be a finite number"),
    (put("s0", "v", "fast"), "s0.v: got 'fast'; it must be a number"),
    (put("s0", "v", float("inf")), "s0.v: got inf; it must be a finite number"),
]


@pytest.mark.parametrize("suffix", ["csv", "json"])
@pytest.mark.parametrize(("mistake", "message"), MISTAKES, ids=[message for _, message in MISTAKES])
def test_a_mistake_is_one_line(tmp_path: Path, mistake: Change, message: str, suffix: str) -> None:
    columns, path = columns_of_the_cart(), tmp_path / f"plan.{suffix}"
    mistake(columns)
    write_by_hand(columns, path)
    with pytest.raises(BadInput) as raised:
        read_plan(path, Cart())
    assert message in str(raised.value)
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("suffix", ["csv", "json"])
def test_a_plan_is_read_as_it_was_written(tmp_path: Path, suffix: str) -> None:
    generator = np.random.default_rng(0)
    plan = Plan(*(generator.uniform(-1, 1, shape).astype(np.float32) for shape in (2, 1, (7, 1))))
    path = tmp_path / f"plan.{suffix}"
    write_plan(path, Cart(), plan)
    read = read_plan(path, Cart())
    for expected, array in zip(vars(plan).values(), vars(read).values(), strict=True):
        np.testing.assert_array_equal(array, expected)
        assert array.dtype == np.float32


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("s0.x,s0.x\n1,2\n", "column 's0.x' appears more than once"),
        ("s0.x,s0.v\n1,2,3\n", "row 1 has 3 cells; the header has 2"),
        ("s0.x,s0.v,goal.target,action.force\n0,0,0,1\n,,,\n,,,1\n", "step 1: got ''"),
    ],
)
def test_mistakes_in_csv(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "plan.csv"
    path.write_text(text)
    with pytest.raises(BadInput, match=message):
        read_plan(path, Cart())


@pytest.mark.parametrize(("text", "message"), [("{", "not JSON"), ("[1]", "the form must be")])
def test_mistakes_in_json(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "plan.json"
    path.write_text(text)
    with pytest.raises(BadInput, match=message):
        read_plan(path, Cart())


def write_by_hand(columns: Columns, path: Path) -> None:
    """Write a plan without `write_plan`."""
    if path.suffix == ".json":
        path.write_text(json.dumps(columns))
        return
    values = {
        f"{group}.{name}": value if isinstance(value, list) else [value]
        for group, members in columns.items()
        for name, value in members.items()
    }
    rows = [
        ",".join(str(v[row]) if row < len(v) else "" for v in values.values())
        for row in range(max(map(len, values.values())))
    ]
    path.write_text("\n".join([",".join(values), *rows]))
