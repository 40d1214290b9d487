"""Every score of every forecaster, beside what to compare it with.

    python -m paper_figs.score_tables results/paper

One table for each level of epistemic uncertainty: a row is a measure, a column a forecaster, the
oracle (the floor) and the ensemble alone at the end. The ruler says how far off an MMD² is: what
right forecasts score when they are shifted by so many standard deviations.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from paper_figs.command import command
from paper_figs.formatting import beyond, latex, number, title
from paper_figs.scores import environments, forecasters, levels, read_scores
from study.config.names import ORACLE, label
from study.metrics.intervals import Interval, interval
from study.metrics.tables.table import select


@dataclass(frozen=True)
class Measure:
    """One row: which metric, what it is called, and what is right."""

    metric: str
    name: str
    right: str
    digits: int = 3


MEASURES = (
    Measure("mmd2", "MMD²", "0", 4),
    Measure("mmd2_half", "MMD², bandwidth × ½", "0", 4),
    Measure("mmd2_double", "MMD², bandwidth × 2", "0", 4),
    Measure("mmd2_joint", "MMD² of the whole state", "0", 4),
    Measure("mmd2_pooled", "MMD², scenarios pooled", "0", 4),
    Measure("crps", "CRPS", "least"),
    Measure("energy_score", "energy score", "least"),
    Measure("brier_fair", "fair Brier score", "least"),
    Measure("coverage_50", "coverage of 50 % intervals", "0.50"),
    Measure("coverage_90", "coverage of 90 % intervals", "0.90"),
    Measure("variance_ratio", "variance / true variance", "1", 2),
    Measure("aleatoric_ratio", "aleatoric / true variance", "1", 2),
    Measure("epistemic_share", "epistemic share of variance", "", 2),
    Measure("nonfinite", "share of values not finite", "0"),
)
BY_DIMENSION = {"variance_ratio", "aleatoric_ratio"}
"""Of these the median over steps and dimensions is shown: a few dimensions outweigh any mean."""
RULER = ("0.1", "0.3", "1")

Entry = Interval | float | None
Table = dict[str, dict[str, Entry]]
"""Measure, then forecaster."""


def plot(results: Path) -> list[Path]:
    """Write tables/scores_<environment>.md and .tex into `results`, from its scores alone.

    Raises:
        BadInput: there are no scores.
    """
    scores = read_scores(results)
    marks = [f"mmd2_shift_{shift}" for shift in RULER]
    scores = scores[scores["metric"].isin([*(m.metric for m in MEASURES), *marks])]
    scores = scores[(scores["step"] == -1) | scores["metric"].isin(BY_DIMENSION)]
    folder = results / "tables"
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for environment in environments(scores):
        own = scores[scores["environment"] == environment]
        tables = {level: rows(own, environment, level) for level in levels(own)}
        for suffix, write in (("md", to_markdown), ("tex", to_latex)):
            path = folder / f"scores_{environment}.{suffix}"
            path.write_text(write(environment, tables, ruler(own)), encoding="utf-8")
            written.append(path)
    return written


def rows(scores: pd.DataFrame, environment: str, level: str) -> Table:
    """The table of one environment and level; measures that no cell has are left out."""
    learned, references = forecasters(scores, environment)
    table = {
        measure.metric: {
            model: _entry(scores, measure.metric, environment, level, model)
            for model in (*learned, *references)
        }
        for measure in MEASURES
    }
    return {
        metric: row for metric, row in table.items() if any(v is not None for v in row.values())
    }


def _entry(scores: pd.DataFrame, metric: str, environment: str, level: str, model: str) -> Entry:
    cell = (metric, environment, level, model)
    if metric in BY_DIMENSION:
        ratio = select(scores, *cell, by="dimension and step").to_numpy(np.float64)
        return float(np.nanmedian(ratio)) if np.isfinite(ratio).any() else None
    by_scenario = select(scores, *cell).to_numpy(np.float64)
    if by_scenario.size:
        return interval(by_scenario)
    whole = scores[(scores["metric"] == metric) & (scores["model"] == model)]
    whole = whole[(whole["dimension"] == "all") & (whole["step"] == -1) & (whole["scenario"] == -1)]
    at_level = whole[whole["level"] == level] if (whole["level"] == level).any() else whole
    known = at_level if model == ORACLE else whole[whole["level"] == level]
    return float(known["value"].mean()) if len(known) else None


def ruler(scores: pd.DataFrame) -> dict[str, float]:
    """MMD² of right forecasts by how many standard deviations they are shifted."""
    whole = scores[(scores["step"] == -1)]
    found = {shift: whole[whole["metric"] == f"mmd2_shift_{shift}"]["value"] for shift in RULER}
    return {shift: float(values.mean()) for shift, values in found.items() if len(values)}


def to_markdown(environment: str, tables: dict[str, Table], marks: dict[str, float]) -> str:
    """A heading and a pipe table for each level, then notes."""
    lines = [f"# Scores, {label(environment)}", ""]
    for level, table in tables.items():
        columns = list(next(iter(table.values()), {}))
        heads = ["", "right", *(title(column) for column in columns)]
        lines += [f"## {title(level)}", "", f"| {' | '.join(heads)} |"]
        lines.append("|---" * 2 + "|---:" * len(columns) + "|")
        for measure in _shown(table):
            texts = [_text(table[measure.metric][c], measure.digits) for c in columns]
            lines.append(f"| {' | '.join([measure.name, measure.right, *texts])} |")
        lines.append("")
    return "\n".join([*lines, *_notes(tables, marks), ""])


def to_latex(environment: str, tables: dict[str, Table], marks: dict[str, float]) -> str:
    """One table for each level, with booktabs."""
    lines = ["% needs \\usepackage{booktabs}"]
    for level, table in tables.items():
        columns = list(next(iter(table.values()), {}))
        caption = f"Scores, {label(environment)}, {label(level)} uncertainty."
        heads = ["", "right", *(latex(title(column)) for column in columns)]
        lines += [
            "\\begin{table*}",
            f"\\caption{{{caption} {latex(' '.join(_notes(tables, marks)))}}}",
            f"\\label{{scores_{environment}_{level}}}",
            "\\centering",
            f"\\begin{{tabular}}{{ll{'r' * len(columns)}}}",
            "\\toprule",
            " & ".join(heads) + " \\\\",
            "\\midrule",
        ]
        for measure in _shown(table):
            entries = [table[measure.metric][column] for column in columns]
            texts = [latex(number(_estimate(entry), measure.digits)) for entry in entries]
            first = [latex(measure.name), latex(measure.right)]
            lines.append(" & ".join([*first, *texts]) + " \\\\")
        lines += ["\\bottomrule", "\\end{tabular}", "\\end{table*}", ""]
    return "\n".join(lines)


def _shown(table: Table) -> list[Measure]:
    return [measure for measure in MEASURES if measure.metric in table]


def _estimate(entry: Entry) -> float | None:
    return entry.estimate if isinstance(entry, Interval) else entry


def _text(entry: Entry, digits: int) -> str:
    text = number(_estimate(entry), digits)
    if isinstance(entry, Interval):
        text += f" [{number(entry.low, digits)}, {number(entry.high, digits)}]"
    return text


def _notes(tables: dict[str, Table], marks: dict[str, float]) -> list[str]:
    entries = [
        entry
        for table in tables.values()
        for row in table.values()
        for model, entry in row.items()
        if isinstance(entry, Interval) and model != ORACLE
    ]
    scenarios = " to ".join(map(str, sorted({entry.scenarios for entry in entries})))
    seeds = sorted({entry.seeds for entry in entries})
    trained = " to ".join(map(str, seeds)) or "no"
    notes = [
        f"{scenarios} scenarios, {trained} training seed{'' if seeds == [1] else 's'}; 95 % "
        f"intervals over {'scenarios only' if seeds == [1] else 'seeds and scenarios'}. MMD², CRPS "
        "and energy score in standard deviations of the training data; ratios of variances are "
        "medians over steps and dimensions.",
        *beyond(model for table in tables.values() for row in table.values() for model in row),
    ]
    if marks:
        shifts = ", ".join(f"{mark:.4f} at {shift}" for shift, mark in marks.items())
        notes.append(
            "Ruler: the MMD² of right forecasts shifted by standard deviations of the observed "
            f"rollouts is {shifts}."
        )
    return notes


if __name__ == "__main__":
    sys.exit(command(plot, "Every score of every forecaster, for each environment and level."))
