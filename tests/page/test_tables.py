"""Tables of a page: entries that say where they come from, and files for a spreadsheet."""

import csv
import io
from urllib.parse import unquote

import pytest

from study.metrics.intervals import Interval
from study.page.tables import Table, estimate, figure, text


def rows_of(table: Table) -> list[list[str]]:
    kind, _, content = table.csv.partition(",")
    assert kind == "data:text/csv;charset=utf-8"
    return list(csv.reader(io.StringIO(unquote(content))))


def test_an_estimate_has_its_interval_and_its_sample_size() -> None:
    value = estimate(Interval(0.12345678, 0.1, 0.2, seeds=3, scenarios=250), "uav/low", digits=3)
    assert (value.text, value.detail, value.order) == ("0.123", "[0.100, 0.200]", 0.12345678)
    assert value.trace.startswith("uav/low\n0.123457, 95 % interval [0.100000, 0.200000]")
    assert value.trace.endswith("n = 250 scenarios × 3 seeds")


@pytest.mark.parametrize(
    ("number", "digits", "shown"),
    [(None, 3, "—"), (float("nan"), 3, "—"), (float("inf"), 0, "∞"), (12345.6, 0, "12,346")],
)
def test_numbers_of_any_kind(number: float | None, digits: int, shown: str) -> None:
    assert figure(number, digits=digits).text == shown


def test_the_file_has_the_rows_of_the_table_or_its_own() -> None:
    rows = [[text("a, b"), figure(1.25)], [text('say "x"'), figure(None)]]
    table = Table("t", "caption", ["name", "value"], rows)
    assert rows_of(table) == [["name", "value"], ["a, b", "1.250"], ['say "x"', "—"]]
    precise = Table("t", "caption", ["name"], rows, download=[["value"], [1.23456789], [None]])
    assert rows_of(precise) == [["value"], ["1.23456789"], [""]]


@pytest.mark.parametrize("formula", ["=1+1", "+1", "@SUM(A1)", "-1+2", "\t=1"])
def test_no_text_is_a_formula_of_a_spreadsheet(formula: str) -> None:
    table = Table("t", "caption", ["name"], [[text(formula)]])
    assert rows_of(table)[1] == [f"'{formula}"]
