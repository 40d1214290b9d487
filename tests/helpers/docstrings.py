"""A docstring against the code: every table row and every number in it."""

import inspect
import re
from collections.abc import Iterable

from study.envs import Simulator, Variable

HEADER = ["| name | unit | meaning | low | high |", "|---|---|---|---|---|"]


def row(variable: Variable) -> str:
    """A line of a table."""
    low, high = f"{variable.low:.4g}", f"{variable.high:.4g}"
    return f"| {variable.name} | {variable.unit} | {variable.meaning} | {low} | {high} |"


def check(
    cls: type[Simulator], tables: Iterable[tuple[Variable, ...]], statements: Iterable[str]
) -> None:
    """The tables of a class's docstring are those of the code, and so is every other number.

    Args:
        cls: the class.
        tables: in the order in which they stand.
        statements: sentences, made from the code's own numbers, that the text has to hold. A number
            in the text that none of them covers is an error.
    """
    lines = [line.strip() for line in (inspect.getdoc(cls) or "").splitlines()]
    rows = [line for line in lines if line.startswith("|") and line not in HEADER]
    assert rows == [row(variable) for table in tables for variable in table]
    text = " ".join(" ".join(line for line in lines if not line.startswith("|")).split())
    for statement in statements:
        assert statement in text, statement
        text = text.replace(statement, "…")
    assert not re.findall(r".{0,30}\d.{0,30}", text)
