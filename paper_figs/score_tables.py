"""Tables of all scores of all forecasters, with the oracle and the ensemble as references.

    python -m paper_figs.score_tables results/paper

One file for each environment, with one table for each level of epistemic uncertainty. Rows are
scores, columns are forecasters. Reference shifts in the notes are the MMD² of the oracle's
forecasts, shifted by some standard deviations of the observed rollouts.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from paper_figs.command import command
from paper_figs.formatting import beyond, latex, number, title
from paper_figs.scores import environments, forecasters, levels, read_scores
from study.config.names import CLIMATOLOGY, ORACLE, label, uncertainty
from study.metrics.intervals import Interval, basis, interval, training_seeds
from study.metrics.tables.scores import SHIFT_METRICS
from study.metrics.tables.table import select
from study.metrics.variance import FIRST_STEP, median_ratio


@dataclass(frozen=True)
class Measure:
    """One row: the metric, its label, its ideal value, and the number of decimals."""

    metric: str
    name: str
    ideal: str
    digits: int = 3


MEASURES = (
    Measure("mmd2", "MMD²", "0", 4),
    Measure("mmd2_half", "MMD², bandwidth × ½", "0", 4),
    Measure("mmd2_double", "MMD², bandwidth × 2", "0", 4),
    Measure("mmd2_joint", "MMD² of the whole state", "0", 4),
    Measure("mmd2_pooled", "MMD², pooled over scenarios", "0", 4),
    Measure("crps", "CRPS", "lowest"),
    Measure("energy_score", "energy score", "lowest"),
    Measure("log_score", "log score", "lowest"),
    Measure("brier", "plain Brier score", "lowest"),
    Measure("brier_fair", "fair Brier score", "lowest"),
    Measure("coverage_50", "coverage of 50 % intervals", "0.50"),
    Measure("coverage_90", "coverage of 90 % intervals", "0.90"),
    Measure("variance_ratio", "forecast variance / true variance", "1", 2),
    Measure("aleatoric_ratio", "aleatoric variance / true variance", "1", 2),
    Measure("epistemic_share", "epistemic share of forecast variance", "", 2),
    Measure("nonfinite", "share of non-finite values", "0"),
)
NOTES_ONCE = (
    "Each scenario was observed once. MMD² is then 1 plus the kernel score: a proper score, whose "
    "lowest value is not 0. Scores that need repeated rollouts are left out: the oracle, ratios to "
    "the true variance and reference shifts. The log score is the negative log-density of an "
    "observed step, given the steps before, in nats for each dimension, with states in standard "
    "deviations of the training data. Only models with a density have one.",
)
NOTE_RATIOS = (
    f"Ratios to the true variance: medians over seeds, dimensions and the steps from {FIRST_STEP} "
    "on, where the true variance is not negligible. "
)
VARIANCE_RATIOS = {"variance_ratio", "aleatoric_ratio"}
"""The metrics whose entry is `study.metrics.variance.median_ratio`."""

Entry = Interval | float | None
Table = dict[str, dict[str, Entry]]
"""By metric, then by forecaster."""


def plot(results: Path) -> list[Path]:
    """Write tables/scores_<environment>.md and .tex into `results`.

    Raises:
        BadInput: there are no scores.
    """
    scores = read_scores(results)
    metrics = [*(measure.metric for measure in MEASURES), *SHIFT_METRICS]
    scores = scores[scores["metric"].isin(metrics)]
    scores = scores[(scores["step"] == -1) | scores["metric"].isin(VARIANCE_RATIOS)]
    folder = results / "tables"
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for environment in environments(scores):
        part = scores[scores["environment"] == environment]
        tables = {level: rows(part, environment, level) for level in levels(part)}
        shifts = reference_shifts(part)
        for suffix, write in (("md", to_markdown), ("tex", to_latex)):
            path = folder / f"scores_{environment}.{suffix}"
            path.write_text(write(environment, tables, shifts), encoding="utf-8")
            written.append(path)
    return written


def rows(scores: pd.DataFrame, environment: str, level: str) -> Table:
    """The table of one environment and level, without metrics that no cell has."""
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
    if metric in VARIANCE_RATIOS:
        ratio = select(scores, *cell, by="dimension and step")
        if not ratio.notna().any(axis=None):
            return None
        return median_ratio(
            ratio.to_numpy(np.float64), ratio.columns.get_level_values("step").to_numpy()
        )
    by_scenario = select(scores, *cell).to_numpy(np.float64)
    if by_scenario.size:
        return interval(by_scenario)
    overall = scores[(scores["metric"] == metric) & (scores["model"] == model)]
    overall = overall[
        (overall["dimension"] == "all") & (overall["step"] == -1) & (overall["scenario"] == -1)
    ]
    at_level = overall[overall["level"] == level]
    if model == ORACLE and at_level.empty:
        at_level = overall
    return float(at_level["value"].mean()) if len(at_level) else None


def reference_shifts(scores: pd.DataFrame) -> dict[float, float]:
    """MMD² of the oracle's shifted forecasts, by the shift in standard deviations."""
    overall = scores[scores["step"] == -1]
    by_shift = {
        shift: overall[overall["metric"] == metric]["value"]
        for metric, shift in SHIFT_METRICS.items()
    }
    return {shift: float(values.mean()) for shift, values in by_shift.items() if len(values)}


def to_markdown(environment: str, tables: dict[str, Table], shifts: dict[float, float]) -> str:
    """A heading and a pipe table for each level, then notes."""
    lines = [f"# Scores, {label(environment)}", ""]
    for level, table in tables.items():
        columns = list(next(iter(table.values()), {}))
        heads = ["", "ideal", *(title(column) for column in columns)]
        lines += [f"## {title(level)}", "", f"| {' | '.join(heads)} |"]
        lines.append("|---" * 2 + "|---:" * len(columns) + "|")
        for measure in _measures(table):
            texts = [_text(table[measure.metric][c], measure.digits) for c in columns]
            lines.append(f"| {' | '.join([measure.name, _ideal(measure, table), *texts])} |")
        lines.append("")
    return "\n".join([*lines, *_notes(tables, shifts), ""])


def to_latex(environment: str, tables: dict[str, Table], shifts: dict[float, float]) -> str:
    """One table for each level, with booktabs."""
    lines = ["% needs \\usepackage{booktabs}"]
    for level, table in tables.items():
        columns = list(next(iter(table.values()), {}))
        caption = f"Scores, {label(environment)}, {uncertainty(level)}."
        heads = ["", "ideal", *(latex(title(column)) for column in columns)]
        lines += [
            "\\begin{table*}",
            f"\\caption{{{caption} {latex(' '.join(_notes(tables, shifts)))}}}",
            f"\\label{{scores_{environment}_{level}}}",
            "\\centering",
            f"\\begin{{tabular}}{{ll{'r' * len(columns)}}}",
            "\\toprule",
            " & ".join(heads) + " \\\\",
            "\\midrule",
        ]
        for measure in _measures(table):
            entries = [table[measure.metric][column] for column in columns]
            texts = [latex(number(_estimate(entry), measure.digits)) for entry in entries]
            first = [latex(measure.name), latex(_ideal(measure, table))]
            lines.append(" & ".join([*first, *texts]) + " \\\\")
        lines += ["\\bottomrule", "\\end{tabular}", "\\end{table*}", ""]
    return "\n".join(lines)


def _measures(table: Table) -> list[Measure]:
    return [measure for measure in MEASURES if measure.metric in table]


def _ideal(measure: Measure, table: Table) -> str:
    """The ideal value; MMD² against one observed rollout is not zero at its best."""
    once = measure.metric.startswith("mmd2") and measure.metric != "mmd2_pooled"
    return "lowest" if once and _is_observed_once(table) else measure.ideal


def _is_observed_once(table: Table) -> bool:
    """Whether the scores compare with one observed rollout of each scenario."""
    return CLIMATOLOGY in next(iter(table.values()), {})


def _estimate(entry: Entry) -> float | None:
    return entry.estimate if isinstance(entry, Interval) else entry


def _text(entry: Entry, digits: int) -> str:
    text = number(_estimate(entry), digits)
    if isinstance(entry, Interval):
        text += f" [{number(entry.low, digits)}, {number(entry.high, digits)}]"
    return text


def _notes(tables: dict[str, Table], shifts: dict[float, float]) -> list[str]:
    entries = [
        entry
        for table in tables.values()
        for row in table.values()
        for model, entry in row.items()
        if isinstance(entry, Interval) and model != ORACLE
    ]
    scenarios = " to ".join(map(str, sorted({entry.scenarios for entry in entries})))
    ratios = any(VARIANCE_RATIOS & set(table) for table in tables.values())
    seeds = {entry.seeds for entry in entries}
    notes = [
        f"{scenarios} scenarios, {training_seeds(seeds)}; in brackets {basis(seeds)}. "
        "MMD² and Brier scores: no unit. CRPS and energy score: in standard "
        f"deviations of the training data. {NOTE_RATIOS * ratios}∞ and −∞: some "
        "forecasts are not finite.",
        *(NOTES_ONCE if any(map(_is_observed_once, tables.values())) else ()),
        *beyond(model for table in tables.values() for row in table.values() for model in row),
    ]
    if shifts:
        values = ", ".join(f"{mmd2:.4f} at {shift:g}" for shift, mmd2 in shifts.items())
        notes.append(
            "Reference shifts: the MMD² of the oracle's forecasts, shifted by standard deviations "
            f"of the observed rollouts, is {values}."
        )
    return notes


if __name__ == "__main__":
    sys.exit(command(plot, "Tables of all scores of all forecasters."))
