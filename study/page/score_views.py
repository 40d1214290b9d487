"""The tables of scores: Brier scores with the paper's values, models side by side, all scores."""

from collections.abc import Iterator, Mapping

from paper_figs import score_tables, tables_1_2_brier
from paper_figs.formatting import title
from paper_figs.scores import environments, levels
from paper_figs.tables_1_2_brier import CLIMATOLOGY, Entry
from study.config.names import label
from study.metrics.intervals import Interval
from study.page.evidence import Evidence
from study.page.tables import Table, Value, estimate, figure, text

CSV_HEADS: tuple[str, ...] = (
    "environment",
    "level",
    "model",
    "metric",
    "estimate",
    "low",
    "high",
    "seeds",
    "scenarios",
    "paper",
)


def brier(evidence: Evidence) -> Iterator[Table]:
    """The paper's Tables I and II: our Brier scores and the paper's."""
    scores = evidence.scores
    if scores is None:
        return
    rows = scores[scores["metric"].isin(["brier", "brier_climatology"]) & (scores["scenario"] >= 0)]
    for environment in environments(rows):
        part = rows[rows["environment"] == environment]
        by_level = tables_1_2_brier.rows(part, environment, evidence.failed_models)
        columns = list(next(iter(by_level.values())))
        yield Table(
            id=f"brier-{environment}",
            caption=f"Plain Brier scores, {label(environment)} (lower is better)",
            heads=["", *map(title, columns)],
            rows=[
                [
                    text(title(level)),
                    *(_brier_entry(row[c], environment, level, c) for c in columns),
                ]
                for level, row in by_level.items()
            ],
            download=[
                CSV_HEADS,
                *(
                    [environment, level, column, "brier", *_numbers(entry.ours), entry.paper]
                    for level, row in by_level.items()
                    for column, entry in row.items()
                ),
            ],
            notes=[tables_1_2_brier.counts(by_level), *tables_1_2_brier.notes(by_level)],
        )


ScoreTables = Mapping[tuple[str, str], score_tables.Table]
"""All scores of an environment and a level."""


def aggregate(evidence: Evidence) -> ScoreTables:
    """The scores of all forecasters, aggregated as in ``tables/scores_<environment>.md``."""
    if evidence.scores is None:
        return {}
    metrics = [measure.metric for measure in score_tables.MEASURES]
    scores = evidence.scores[evidence.scores["metric"].isin(metrics)]
    scores = scores[(scores["step"] == -1) | scores["metric"].isin(score_tables.VARIANCE_RATIOS)]
    tables = {}
    for environment in environments(scores):
        part = scores[scores["environment"] == environment]
        for level in levels(part):
            tables[environment, level] = score_tables.rows(part, environment, level)
    return tables


def all_scores(tables: ScoreTables) -> Table | None:
    """Every score of every forecaster, one row each."""
    rows: list[list[Value]] = []
    download: list[list[object]] = [list(CSV_HEADS[:-1])]
    for environment, level, model, measure, entry in _entries(tables):
        rows.append(
            [
                text(label(environment)),
                text(label(level)),
                text(label(model)),
                text(measure.name),
                score(entry, environment, level, model, measure),
                text(measure.ideal),
                _count(entry, "scenarios"),
                _count(entry, "seeds"),
            ]
        )
        download.append([environment, level, model, measure.metric, *_numbers(entry)])
    if not rows:
        return None
    return Table(
        id="all-scores",
        caption="All scores",
        heads=[
            "environment", "level", "model", "score", "mean", "ideal", "scenarios", "seeds",
        ],
        rows=rows,
        download=download,
        tools=True,
    )  # fmt: skip


def _entries(
    tables: ScoreTables,
) -> Iterator[tuple[str, str, str, score_tables.Measure, Interval | float]]:
    for (environment, level), table in tables.items():
        for measure in score_tables.MEASURES:
            for model, entry in table.get(measure.metric, {}).items():
                if entry is not None:
                    yield environment, level, model, measure, entry


def score(
    entry: score_tables.Entry,
    environment: str,
    level: str,
    model: str,
    measure: score_tables.Measure,
) -> Value:
    """A score with its interval and where it comes from."""
    trace = source(environment, level, model, measure.metric)
    if isinstance(entry, Interval):
        return estimate(entry, trace, measure.digits)
    return figure(entry, trace, measure.digits)


def _brier_entry(entry: Entry, environment: str, level: str, model: str) -> Value:
    paper = "" if entry.paper is None else f"paper {entry.paper:.3f}"
    if entry.ours is None:
        return Value("failed" if entry.failed else "—", paper, kind="number")
    metric = "brier_climatology" if model == CLIMATOLOGY else "brier"
    found = estimate(
        entry.ours, source(environment, level, model, metric), kind="best" if entry.best else ""
    )
    if not paper:
        return found
    return Value(
        found.text, f"{found.detail}\n{paper}", found.trace, found.order, found.kind, found.links
    )


def source(environment: str, level: str, model: str, metric: str) -> str:
    """Where a score is: its cells and its metric."""
    return f"{environment}/{level}/{model}, all seeds\nscores.parquet: metric = {metric}"


def _numbers(entry: Interval | float | None) -> list[float | int | None]:
    if isinstance(entry, Interval):
        return [entry.estimate, entry.low, entry.high, entry.seeds, entry.scenarios]
    return [entry, None, None, None, None]


def _count(entry: Interval | float, name: str) -> Value:
    if not isinstance(entry, Interval):
        return text(None, kind="number")
    count: int = getattr(entry, name)
    return text(count, order=float(count), kind="number")
