"""The tables of outcome forecasts: Brier score, skill, reliability and resolution."""

from collections.abc import Iterator

from paper_figs.formatting import title
from paper_figs.outcome_tables import GOAL, TERMS, Block, Row, blocks
from paper_figs.scores import environments, levels, main_outcome, rollouts
from study.config.names import label
from study.page.evidence import Evidence
from study.page.score_views import source
from study.page.tables import Table, Value, estimate, figure, text

METRICS = ("brier", "brier_fair", "brier_climatology", "observed_probability", *TERMS)
HEADS = (
    "outcome", "level", "forecaster", "plain Brier score", "skill", "reliability", "resolution"
)  # fmt: skip
NOTE = (
    "Skill is that of the fair Brier score: 0 for the climatology, 1 for the expected score of the "
    "oracle. Reliability (lower is better) and resolution (higher is better) are terms of the fair "
    "Brier score."
)


def tables(evidence: Evidence) -> Iterator[Table]:
    """One table for each environment, with a row for each outcome, level and forecaster."""
    if evidence.scores is None:
        return
    scores = evidence.scores[
        evidence.scores["metric"].isin(METRICS) & (evidence.scores["step"] == -1)
    ]
    for environment in environments(scores):
        part = scores[scores["environment"] == environment]
        observed = rollouts(evidence.out, environment)
        main = main_outcome(evidence.out, environment)
        rows = [
            _entries(environment, level, block, row)
            for level in levels(part)
            for block in blocks(part, environment, level, observed, main)
            for row in block.rows
        ]
        shown = [entries for entries in rows if entries]
        caption = f"Forecasts of outcomes, {label(environment)}"
        name = f"outcomes-{environment}"
        yield Table(name, caption, HEADS, shown, notes=[NOTE], tools=True)


def _entries(environment: str, level: str, block: Block, row: Row) -> list[Value]:
    """The entries of one forecaster; none without scores."""
    if row.score is None:
        return []
    dimension = "" if block.outcome == GOAL else f", dimension = {block.outcome}"
    brier, fair, *terms = (
        source(environment, level, row.model, metric) + dimension
        for metric in ("brier", "brier_fair", *TERMS)
    )
    return [
        text(block.name or block.outcome),
        text(label(level)),
        text(title(row.model)),
        estimate(row.score, brier, kind="best" if row.best else ""),
        figure(row.skill, fair, 2),
        *(figure(term, trace) for term, trace in zip(row.terms, terms, strict=True)),
    ]
