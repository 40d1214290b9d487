"""The table of scenarios with recorded forecasts; a link opens the very scenario."""

import pandas as pd

from study.common.errors import StudyError
from study.page.cells import cell_rows
from study.page.evidence import Evidence
from study.page.tables import Table, Value, figure, text
from study.recording.tabs import Layout, scenario_numbers

FORECAST = "forecast.rrd"
METRICS = {"mmd2": ("MMD²", 4), "brier": ("plain Brier score", 4)}


def table(evidence: Evidence) -> Table | None:
    """One row for each cell and scenario with recorded forecasts; None without any."""
    rows = []
    for name in evidence.recordings:
        folder, _, kind = name.rpartition("/")
        if kind == FORECAST and name.count("/") > 1:
            rows += _rows(evidence, name, folder.removeprefix("recordings/"))
    heads = ["scenario", "cell", "number", *(title for title, _ in METRICS.values())]
    caption = "Scenarios with recorded forecasts"
    return Table("scenarios", caption, heads, rows, tools=True) if rows else None


def _rows(evidence: Evidence, name: str, cell: str) -> list[list[Value]]:
    """The scenarios of one recording. The page names a damaged recording elsewhere."""
    path = evidence.out / name
    try:
        titles, numbers = Layout(path).tabs, scenario_numbers(path)
    except StudyError:
        return []
    scores = cell_rows(evidence, cell)
    return [
        [
            Value("", links=[(title, f"{name}?tab={tab}")]),
            text(cell),
            text(numbers[title], order=float(numbers[title]), kind="number"),
            *(
                _score(scores, cell, metric, numbers[title], digits)
                for metric, (_, digits) in METRICS.items()
            ),
        ]
        for tab, title in enumerate(titles)
        if title in numbers
    ]


def _score(
    scores: pd.DataFrame | None, cell: str, metric: str, scenario: int, digits: int
) -> Value:
    if scores is None:
        return figure(None)
    values = scores.loc[(scores["metric"] == metric) & (scores["scenario"] == scenario), "value"]
    trace = f"{cell}, scenario {scenario}\nscores.parquet: metric = {metric}"
    return figure(float(values.iloc[0]) if len(values) else None, trace, digits)
