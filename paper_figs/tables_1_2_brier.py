"""Tables I and II of the paper: our Brier scores with intervals, and the paper's values.

    python -m paper_figs.tables_1_2_brier results/paper

One table for each environment. Rows are the levels of epistemic uncertainty, columns are the models
and the references: the oracle (the lowest possible expected score), the ensemble alone, and the
climatology (the score of the base rate of success as a forecast).
"""

import sys
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from paper_figs.command import command
from paper_figs.formatting import beyond, latex, title
from paper_figs.scores import (
    environments,
    failed_cells,
    forecasters,
    in_order,
    levels,
    models,
    read_scores,
)
from study.claims.paper import BRIER
from study.config.names import LEVELS, ORACLE, label
from study.metrics.intervals import Interval, basis, interval, training_seeds
from study.metrics.tables.table import select

CLIMATOLOGY = "climatology"


@dataclass(frozen=True)
class Entry:
    """One cell of the table: our score, None without one, and the paper's value."""

    ours: Interval | None
    paper: float | None
    best: bool = False
    failed: bool = False


Row = dict[str, Entry]


def plot(results: Path) -> list[Path]:
    """Write tables/brier_<environment>.md and .tex into `results`.

    Raises:
        BadInput: there are no scores.
    """
    scores = read_scores(results)
    scores = scores[
        scores["metric"].isin(["brier", "brier_climatology"]) & (scores["scenario"] >= 0)
    ]
    folder = results / "tables"
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for environment in environments(scores):
        part = scores[scores["environment"] == environment]
        table = rows(part, environment, failed_cells(results))
        for suffix, text in (
            ("md", to_markdown(environment, table)),
            ("tex", to_latex(environment, table)),
        ):
            path = folder / f"brier_{environment}.{suffix}"
            path.write_text(text, encoding="utf-8")
            written.append(path)
    return written


def rows(
    scores: pd.DataFrame, environment: str, failed: Collection[tuple[str, str, str]] = ()
) -> dict[str, Row]:
    """The entries of one environment by level, then by column.

    In the paper's environments, the paper's levels and models are included with or without scores.

    Args:
        scores: of the environment.
        environment: its name.
        failed: environment, level and model of the cells that failed.
    """
    is_of_paper = any(environment == name for name, _, _ in BRIER)
    learned, references = forecasters(scores, environment)
    table = {}
    for level in in_order([*LEVELS, *levels(scores)] if is_of_paper else levels(scores), LEVELS):
        row = {
            model: Entry(
                _measure(scores, "brier", environment, level, model),
                BRIER.get((environment, level, model)),
                failed=(environment, level, model) in failed,
            )
            for model in (*learned, *references)
        }
        row[CLIMATOLOGY] = Entry(_climatology(scores, environment, level), None)
        table[level] = _mark_best(row, learned)
    return table


def _measure(
    scores: pd.DataFrame, metric: str, environment: str, level: str, model: str
) -> Interval | None:
    values = select(scores, metric, environment, level, model)
    return None if values.empty else interval(values.to_numpy(np.float64))


def _climatology(scores: pd.DataFrame, environment: str, level: str) -> Interval | None:
    """The score of the climatology, from any cell, since it does not depend on the model."""
    for model in models(scores):
        values = select(scores, "brier_climatology", environment, level, model)
        if not values.empty:
            return interval(values.to_numpy(np.float64)[:1])
    return None


def _mark_best(row: Row, learned: list[str]) -> Row:
    """Mark the lowest score of the learned models, which is bold as in the paper."""
    scored = {model: ours.estimate for model in learned if (ours := row[model].ours) is not None}
    best = min(scored, key=scored.__getitem__, default=None)
    return {name: replace(entry, best=name == best) for name, entry in row.items()}


MISSING = "not run"


def to_markdown(environment: str, table: dict[str, Row]) -> str:
    """A Markdown table with a title and notes."""
    columns = list(next(iter(table.values())))
    lines = [
        f"# Plain Brier scores, {label(environment)} (lower is better)",
        "",
        f"| | {' | '.join(title(column) for column in columns)} |",
        "|---" * (len(columns) + 1) + "|",
    ]
    for level, row in table.items():
        entries = [_markdown_entry(row[column]) for column in columns]
        lines.append(f"| {title(level)} | {' | '.join(entries)} |")
    return "\n".join([*lines, "", counts(table), *notes(table), ""])


def _markdown_entry(entry: Entry) -> str:
    if entry.ours is None:
        text = "failed" if entry.failed else "—"
    else:
        mean = f"{entry.ours.estimate:.3f}"
        text = f"**{mean}**" if entry.best else mean
        text += f" [{entry.ours.low:.3f}, {entry.ours.high:.3f}]"
    return text if entry.paper is None else f"{text}<br>paper {entry.paper:.3f}"


def to_latex(environment: str, table: dict[str, Row]) -> str:
    """A LaTeX table over two columns, with booktabs."""
    columns = list(next(iter(table.values())))
    lines = [
        "% needs \\usepackage{booktabs}",
        "\\begin{table*}",
        f"\\caption{{Plain Brier scores for {label(environment)} (lower is better). "
        f"{latex(' '.join([counts(table), *notes(table)]))}}}",
        f"\\label{{brier_{environment}}}",
        "\\centering",
        f"\\begin{{tabular}}{{l{'c' * len(columns)}}}",
        "\\toprule",
        " & ".join(["", *(latex(title(column)) for column in columns)]) + " \\\\",
        "\\midrule",
    ]
    for level, row in table.items():
        lines.append(_latex_line(title(level), [_latex_mean(row[c]) for c in columns]))
        lines.append(_latex_line("", [_latex_interval(row[c]) for c in columns]))
        if any(entry.paper is not None for entry in row.values()):
            lines.append(_latex_line("\\quad paper", [_latex_paper(row[c]) for c in columns]))
    return "\n".join([*lines, "\\bottomrule", "\\end{tabular}", "\\end{table*}", ""])


def _latex_line(head: str, cells: list[str]) -> str:
    return " & ".join([head, *cells]) + " \\\\"


def _latex_mean(entry: Entry) -> str:
    if entry.ours is None:
        return "failed" if entry.failed else "---"
    mean = f"{entry.ours.estimate:.3f}"
    return f"\\textbf{{{mean}}}" if entry.best else mean


def _latex_interval(entry: Entry) -> str:
    return f"{{\\small [{entry.ours.low:.3f}, {entry.ours.high:.3f}]}}" if entry.ours else ""


def _latex_paper(entry: Entry) -> str:
    return "" if entry.paper is None else f"{entry.paper:.3f}"


def counts(table: dict[str, Row]) -> str:
    """The numbers of scenarios and seeds, and what intervals and scores mean."""
    measured = [entry.ours for row in table.values() for entry in row.values() if entry.ours]
    scenarios = " to ".join(map(str, sorted({m.scenarios for m in measured})))
    seeds = {
        entry.ours.seeds
        for row in table.values()
        for name, entry in row.items()
        if entry.ours and name not in (ORACLE, CLIMATOLOGY)
    }
    return (
        f"{scenarios} scenarios, {training_seeds(seeds)}; in brackets {basis(seeds)}. A plain "
        "Brier score is the mean (p - o)², without unit; that of a forecast with few samples is "
        "higher than that of its probability."
    )


def notes(table: dict[str, Row]) -> list[str]:
    """What the marks † and — mean, if they occur."""
    entries = [entry for row in table.values() for entry in row.values()]
    missing = any(entry.ours is None and not entry.failed for entry in entries)
    models_beyond = beyond(name for row in table.values() for name in row)
    return [*models_beyond, f"— {MISSING}."] if missing else models_beyond


if __name__ == "__main__":
    sys.exit(command(plot, "Brier scores: the paper's Tables I and II."))
