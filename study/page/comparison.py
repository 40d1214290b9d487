"""Two studies side by side: the settings, scores, verdicts and versions that differ."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from paper_figs.score_tables import MEASURES, Measure
from paper_figs.scores import environments, levels, models
from study.common.arrays import Doubles
from study.common.files import write_text
from study.config.convert import by_dotted_name
from study.config.names import label
from study.metrics.intervals import Interval, difference, interval, sum_of_means
from study.metrics.tables.table import select
from study.page.environment import templates
from study.page.evidence import Evidence, read
from study.page.settings_view import shown
from study.page.tables import Table, Value, estimate, text

TEST_SET = ("collect.scenarios", "collect.rollouts", "collect.seed", "collect.horizon")
"""The settings that define the test set."""
HEADS = ("environment", "level", "model", "score", "A", "B", "B − A", "result")
LOWER, HIGHER, UNDECIDED = "lower", "higher", "undecided"


def write_comparison(first: Path, second: Path) -> Path:
    """Write the page that compares two results folders, into the second one.

    Raises:
        BadInput: a folder has no results.
    """
    path = second / f"against_{first.resolve().name}.html"
    write_text(path, render(read(first), read(second)))
    return path


def render(first: Evidence, second: Evidence) -> str:
    """The page that compares two studies."""
    paired = same_test_set(first, second)
    table, results = scores(first, second, paired)
    verdict_rows = verdicts(first, second)
    return (
        templates()
        .get_template("comparison.html")
        .render(
            first=first,
            second=second,
            problems=[
                f"{evidence.out}: {problem}"
                for evidence in (first, second)
                for problem in evidence.problems
            ],
            failed=[*first.failed, *second.failed],
            paired=paired,
            settings=settings(first, second),
            scores=table,
            summary=_summary(results),
            verdicts=verdict_rows,
            changed=sum(row[-1].text == "differs" for row in verdict_rows.rows)
            if verdict_rows
            else 0,
            origin=origin(first, second),
        )
    )


def same_test_set(first: Evidence, second: Evidence) -> bool:
    """Whether both studies have the same test scenarios, by their settings."""
    one, other = (by_dotted_name(evidence.settings) for evidence in (first, second))
    return bool(one) and all(one.get(name) == other.get(name) for name in TEST_SET)


def settings(first: Evidence, second: Evidence) -> Table:
    """The settings that differ."""
    rows = _different(by_dotted_name(first.settings), by_dotted_name(second.settings))
    heads = ["setting", "A", "B"]
    return Table("settings-that-differ", "Settings that differ", heads, rows, tools=True)


def origin(first: Evidence, second: Evidence) -> Table:
    """The versions, machines and modules that differ."""
    rows = _different(_origin(first), _origin(second))
    return Table("origins-that-differ", "Versions and source that differ", ["", "A", "B"], rows)


def verdicts(first: Evidence, second: Evidence) -> Table | None:
    """The verdict of both studies on each claim."""
    one, other = ({str(c["id"]): c for c in e.claims} for e in (first, second))
    rows = []
    for name in [*one, *(name for name in other if name not in one)]:
        claim = one.get(name) or other[name]
        pair = [str(claims[name]["verdict"]) if name in claims else "—" for claims in (one, other)]
        result = "same" if pair[0] == pair[1] else "differs"
        rows.append([text(str(claim["text"])), *map(text, pair), text(result)])
    heads = ["claim", "A", "B", "result"]
    return Table("both-verdicts", "Verdicts", heads, rows, tools=True) if rows else None


def scores(first: Evidence, second: Evidence, paired: bool) -> tuple[Table | None, list[str]]:
    """All scores of both studies with their differences, and the result of each."""
    if first.scores is None or second.scores is None:
        return None, []
    rows: list[list[Value]] = []
    download: list[list[Any]] = [
        [*HEADS[:4], "A", "B", "difference", "low", "high", "seeds", "scenarios"]
    ]
    results = []
    for cell, measure, one, other in _pairs(first.scores, second.scores):
        trace = f"{'/'.join(cell)}, all seeds\nscores.parquet: metric = {measure.metric}"
        ends = [_entry(values, f"{name}: {trace}", measure) for name, values in
                (("A", one), ("B", other))]  # fmt: skip
        found = _difference(one, other, paired) if one.size and other.size else None
        result = _result(found)
        results += [result] if found else []
        rows.append(
            [
                *(text(label(name)) for name in cell),
                text(measure.name),
                *ends,
                estimate(found, f"B − A: {trace}", measure.digits) if found else text("—"),
                text(result),
            ]
        )
        numbers = (
            [found.estimate, found.low, found.high, found.seeds, found.scenarios] if found else []
        )
        download.append([*cell, measure.metric, ends[0].order, ends[1].order, *numbers])
    caption = "Scores of both studies"
    table = Table("both-scores", caption, HEADS, rows, download, tools=True) if rows else None
    return table, results


def _pairs(
    first: pd.DataFrame, second: pd.DataFrame
) -> Iterator[tuple[tuple[str, str, str], Measure, pd.DataFrame, pd.DataFrame]]:
    """The values [seeds, S] of each cell and score that one of the studies has."""
    metrics = [measure.metric for measure in MEASURES]
    one, other = (t[t["metric"].isin(metrics) & (t["step"] == -1)] for t in (first, second))
    both = pd.concat([one, other])
    for environment in environments(both):
        for level in levels(both):
            for model in models(both):
                for measure in MEASURES:
                    cell = (environment, level, model)
                    values = [select(t, measure.metric, *cell) for t in (one, other)]
                    if values[0].size or values[1].size:
                        yield cell, measure, values[0], values[1]


def _entry(values: pd.DataFrame, trace: str, measure: Measure) -> Value:
    if not values.size:
        return text(None, kind="number")
    return estimate(interval(values.to_numpy(np.float64)), trace, measure.digits)


def _difference(one: pd.DataFrame, other: pd.DataFrame, paired: bool) -> Interval:
    """The mean of `other` minus the mean of `one`, paired if the seeds and scenarios are."""
    seeds = sorted(set(one.index) & set(other.index))
    scenarios = sorted(set(one.columns) & set(other.columns))
    if paired and seeds and scenarios:
        a, b = (t.loc[seeds, scenarios].to_numpy(np.float64) for t in (one, other))
        return difference(b, a)
    negated: Doubles = -one.to_numpy(np.float64)
    found = sum_of_means([other.to_numpy(np.float64), negated])
    counts = [min(a, b) for a, b in zip(one.shape, other.shape, strict=True)]
    return Interval(float(found.estimate), float(found.low), float(found.high), *counts)


def _result(found: Interval | None) -> str:
    if found is None:
        return "—"
    if found.low <= 0 <= found.high:
        return UNDECIDED
    return HIGHER if found.estimate > 0 else LOWER


def _summary(results: list[str]) -> dict[str, int] | None:
    counts = {name: results.count(name) for name in (LOWER, HIGHER, UNDECIDED)}
    return counts | {"compared": len(results)} if results else None


def _different(one: Mapping[str, Any], other: Mapping[str, Any]) -> list[list[Value]]:
    names = sorted({*one, *other})
    return [
        [text(name), text(_shown(one, name)), text(_shown(other, name))]
        for name in names
        if one.get(name) != other.get(name)
    ]


def _shown(values: Mapping[str, Any], name: str) -> str:
    return shown(values[name]) if name in values else "—"


def _origin(evidence: Evidence) -> dict[str, Any]:
    facts = {name: evidence.facts.get(name, "") for name in ("study", "device", "compiler")}
    for group in ("versions", "source"):
        entries = evidence.facts.get(group)
        if isinstance(entries, Mapping):
            facts |= {f"{group}: {name}": value for name, value in entries.items()}
    return facts
