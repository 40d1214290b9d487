"""Tables of outcome forecasts: Brier score, skill, reliability and resolution.

    python -m paper_figs.outcome_tables results/paper

One file for each environment, with one table for each level of epistemic uncertainty. Each outcome
has a block of rows, one for each forecaster and one for the climatology; the goal comes first.
The column of scores has the plain Brier score. Skill (`study.metrics.brier.skill`) is that of the
fair Brier score: 0 for the climatology, 1 for the expected score of the oracle. Reliability and
resolution are terms of the fair Brier score (`study.metrics.reliability`).
"""

import sys
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from paper_figs.command import command
from paper_figs.formatting import beyond, latex, number, title
from paper_figs.scores import environments, forecasters, levels, main_outcome, read_scores, rollouts
from study.common.arrays import Doubles
from study.config.names import CLIMATOLOGY, ORACLE, label, markdown, uncertainty
from study.metrics.brier import SMALLEST_RANGE, brier_oracle, skill
from study.metrics.intervals import Interval, basis, interval, training_seeds
from study.metrics.tables.table import LEVELLESS

GOAL = "all"
"""The name of the goal in the column `dimension` of the scores."""
TERMS = ("brier_reliability", "brier_resolution")


@dataclass(frozen=True)
class Row:
    """One forecaster, with its plain score; None for missing scores and an undefined skill."""

    model: str
    score: Interval | None
    skill: float | None
    terms: tuple[float | None, ...]
    best: bool


@dataclass(frozen=True)
class Block:
    """One outcome: its base rate, the score of the climatology, and the forecasters."""

    outcome: str
    base_rate: float
    climatology: float
    rows: tuple[Row, ...]
    name: str = ""


def plot(results: Path) -> list[Path]:
    """Write tables/outcomes_<environment>.md and .tex into `results`.

    Raises:
        BadInput: there are no scores.
    """
    scores = read_scores(results)
    metrics = ["brier", "brier_fair", "brier_climatology", "observed_probability", *TERMS]
    scores = scores[scores["metric"].isin(metrics) & (scores["step"] == -1)]
    folder = results / "tables"
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for environment in environments(scores):
        part = scores[scores["environment"] == environment]
        observed, main = rollouts(results, environment), main_outcome(results, environment)
        tables = {level: blocks(part, environment, level, observed, main) for level in levels(part)}
        with_terms = bool(part["metric"].isin(TERMS).any())
        for suffix, write in (("md", to_markdown), ("tex", to_latex)):
            path = folder / f"outcomes_{environment}.{suffix}"
            path.write_text(write(environment, tables, with_terms), encoding="utf-8")
            written.append(path)
    return written


def blocks(
    scores: pd.DataFrame,
    environment: str,
    level: str,
    observed: int | None,
    main: str = "reaches the goal",
) -> list[Block]:
    """The blocks of one environment and level.

    In the paper's environments, the paper's models are included with or without scores. Other
    models, the oracle and the ensemble follow.

    Args:
        scores: of the environment.
        environment: its name.
        level: the level.
        observed: the number of observed rollouts of a scenario. None leaves the skill undefined.
        main: name of the main outcome.
    """
    learned, references = forecasters(scores, environment)
    cells = {model: _cell(scores, level, model) for model in (*learned, *references)}
    names = scores.loc[scores["metric"] == "brier", "dimension"].unique()
    outcomes = [GOAL, *(name for name in names if name != GOAL)]
    found = [_block(cells, name, learned, observed) for name in outcomes]
    return [replace(b, name=main) if b.outcome == GOAL else b for b in found]


def _cell(scores: pd.DataFrame, level: str, model: str) -> pd.DataFrame:
    """All rows of a model at a level. A model without levels has the same rows at every level."""
    rows = scores[scores["model"] == model]
    at_level = rows[rows["level"] == level]
    if model in LEVELLESS and at_level.empty and len(rows):
        return rows[rows["level"] == rows["level"].iloc[0]]
    return at_level


def _block(
    cells: dict[str, pd.DataFrame], outcome: str, learned: list[str], count: int | None
) -> Block:
    by_model = {model: _by_scenario(cell, "brier", outcome) for model, cell in cells.items()}
    scores = {model: interval(values) for model, values in by_model.items() if values.size}
    # Observed rollouts are the same for all cells.
    observed = [_by_scenario(cell, "observed_probability", outcome) for cell in cells.values()]
    climatology = [_overall(cell, "brier_climatology", outcome) for cell in cells.values()]
    reference = _first(climatology)
    oracle = np.nan
    if count == 1:
        oracle = 0.0  # the best possible probability is not known; a perfect forecast has score 0
    elif count:
        oracle = _first(brier_oracle(values, count) for values in observed)
    rows = tuple(
        Row(
            model,
            scores.get(model),
            _skill(_mean(_overall(cell, "brier_fair", outcome)), oracle, reference),
            tuple(_mean(_overall(cell, term, outcome)) for term in TERMS),
            model in learned and _is_lowest(model, learned, scores),
        )
        for model, cell in cells.items()
    )
    return Block(outcome, _first(observed), reference, rows)


def _skill(fair: float | None, oracle: float, climatology: float) -> float | None:
    value = np.nan if fair is None else skill(fair, oracle, climatology)
    return None if np.isnan(value) else value


def _is_lowest(model: str, learned: list[str], scores: dict[str, Interval]) -> bool:
    """Whether a model's score is below those of all other learned models; False in a tie."""
    rest = [scores[name].estimate for name in learned if name in scores and name != model]
    return model in scores and all(scores[model].estimate < estimate for estimate in rest)


def _rows_of(cell: pd.DataFrame, metric: str, outcome: str) -> pd.DataFrame:
    return cell[(cell["metric"] == metric) & (cell["dimension"] == outcome)]


def _by_scenario(cell: pd.DataFrame, metric: str, outcome: str) -> Doubles:
    """Values [seeds, S]."""
    rows = _rows_of(cell, metric, outcome)
    rows = rows[rows["scenario"] >= 0]
    return rows.pivot(index="seed", columns="scenario", values="value").to_numpy(np.float64)


def _overall(cell: pd.DataFrame, metric: str, outcome: str) -> Doubles:
    """Values [seeds]."""
    rows = _rows_of(cell, metric, outcome)
    return rows.loc[rows["scenario"] == -1, "value"].to_numpy(np.float64)


def _mean(values: Doubles) -> float | None:
    return float(values.mean()) if values.size and not np.isnan(values).any() else None


def _first(by_cell: Iterable[Doubles]) -> float:
    """The mean of the first seed of the first cell with values; NaN without values."""
    return next((float(values[0].mean()) for values in by_cell if values.size), np.nan)


Tables = dict[str, list[Block]]


def to_markdown(environment: str, tables: Tables, with_terms: bool) -> str:
    """A heading and a pipe table for each level, then notes."""
    heads = ["Outcome", "Forecaster", "Plain Brier score", "Skill", *_term_heads(with_terms)]
    lines = [f"# Forecasts of outcomes, {label(environment)}", ""]
    for level, table in tables.items():
        lines += [f"## {title(level)}", "", f"| {' | '.join(heads)} |"]
        lines.append("|---" * 2 + "|---:" * (len(heads) - 2) + "|")
        for block in table:
            for at, (row, texts) in enumerate(_texts(block, with_terms)):
                outcome = f"**{markdown(_name(block))}**<br>{_base_rate(block)}" if at == 0 else ""
                if row is not None and row.best:
                    texts[1] = f"**{texts[1]}**"
                score = " ".join(texts[1:3]).strip()
                lines.append(f"| {' | '.join([outcome, texts[0], score, *texts[3:]])} |")
        lines.append("")
    return "\n".join([*lines, " ".join(_notes(tables, with_terms)), ""])


def to_latex(environment: str, tables: Tables, with_terms: bool) -> str:
    """One table for each level, with booktabs."""
    heads = ["Outcome", "Forecaster", "Plain Brier score", "95\\,\\% interval", "Skill"]
    heads += _term_heads(with_terms)
    lines = ["% needs \\usepackage{booktabs}"]
    for level, table in tables.items():
        caption = f"Forecasts of outcomes, {label(environment)}, {uncertainty(level)}."
        lines += [
            "\\begin{table*}",
            f"\\caption{{{caption} {latex(' '.join(_notes({level: table}, with_terms)))}}}",
            f"\\label{{outcomes_{environment}_{level}}}",
            "\\centering",
            f"\\begin{{tabular}}{{ll{'r' * (len(heads) - 2)}}}",
            "\\toprule",
            " & ".join(heads) + " \\\\",
        ]
        for block in table:
            lines.append("\\midrule")
            begins = [_name(block), _base_rate(block)]
            for at, (row, texts) in enumerate(_texts(block, with_terms)):
                texts = [latex(text) for text in texts]
                if row is not None and row.best:
                    texts[1] = f"\\textbf{{{texts[1]}}}"
                begin = latex(begins[at]) if at < len(begins) else ""
                lines.append(" & ".join([begin, *texts]) + " \\\\")
        lines += ["\\bottomrule", "\\end{tabular}", "\\end{table*}", ""]
    return "\n".join(lines)


def _texts(block: Block, with_terms: bool) -> list[tuple[Row | None, list[str]]]:
    """The lines of a block: forecaster, score, interval, skill, terms; climatology last."""
    lines: list[tuple[Row | None, list[str]]] = []
    for row in block.rows:
        ours = row.score
        texts = [label(row.model), number(ours.estimate if ours else None)]
        texts += [f"[{ours.low:.3f}, {ours.high:.3f}]" if ours else "", number(row.skill, 2)]
        lines.append((row, texts + [number(term) for term in row.terms if with_terms]))
    climatology = ["climatology", number(block.climatology), "", number(0.0, 2)]
    return [*lines, (None, climatology + [number(0.0) for _ in TERMS if with_terms])]


def _term_heads(with_terms: bool) -> list[str]:
    return ["Reliability", "Resolution"] if with_terms else []


def _name(block: Block) -> str:
    return title(block.name or block.outcome)


def _base_rate(block: Block) -> str:
    return "" if np.isnan(block.base_rate) else f"base rate {block.base_rate:.2f}"


def _notes(tables: Tables, with_terms: bool) -> list[str]:
    rows = [row for table in tables.values() for block in table for row in block.rows]
    measured = [row.score for row in rows if row.score]
    scenarios = " to ".join(map(str, sorted({score.scenarios for score in measured})))
    seeds = {row.score.seeds for row in rows if row.score and row.model != ORACLE}
    once = any(row.model == CLIMATOLOGY for row in rows)
    best = "a perfect forecast" if once else "the expected score of the oracle"
    notes = [
        f"{scenarios} scenarios, {training_seeds(seeds)}; in brackets {basis(seeds)}.",
        "Plain Brier score: lower is better. Skill, of the fair Brier score: 0 for the climatology "
        f"(the base rate), 1 for {best}; — where these two differ by less than {SMALLEST_RANGE:g}.",
        *beyond(row.model for row in rows),
    ]
    if with_terms:
        notes.append(
            "Reliability: lower is better. Resolution: higher is better. Both estimates are "
            "unbiased and can be slightly negative."
        )
    if any(row.score is None for row in rows):
        notes.append("— as a score: the cell failed or did not run.")
    return notes


if __name__ == "__main__":
    sys.exit(command(plot, "Brier score, skill, reliability and resolution of outcome forecasts."))
