"""The main numbers of each cell, from the files of a results folder."""

from pathlib import Path

import pandas as pd

from paper_figs.scores import read_scores
from study.common.errors import BadInput
from study.metrics.tables.table import CELL, cell_name
from study.results.summary import FITS

METRICS = ("mmd2", "brier")


def cell_scores(out: Path) -> dict[str, dict[str, float]]:
    """The mean MMD² and plain Brier score over scenarios, and β, by the name of the cell.

    A number that the folder does not have is left out.
    """
    numbers: dict[str, dict[str, float]] = {}
    try:
        scores = read_scores(out)
    except BadInput:
        return numbers
    of_scenarios = scores[
        scores["metric"].isin(METRICS)
        & (scores["dimension"] == "all")
        & (scores["step"] == -1)
        & (scores["scenario"] >= 0)
    ]
    means = of_scenarios.groupby([*CELL, "metric"], observed=True)["value"].mean().reset_index()
    for row in means.to_dict("records"):
        numbers.setdefault(cell_name(row), {})[str(row["metric"])] = float(row["value"])
    for name, beta in _betas(out).items():
        numbers.setdefault(name, {})["beta"] = beta
    return numbers


def _betas(out: Path) -> dict[str, float]:
    """The β of each fitted model; empty without a readable table of fits."""
    try:
        fits = pd.read_parquet(out / FITS)
        rows = [row for row in fits.to_dict("records") if pd.notna(row["beta"])]
        return {cell_name(row): float(row["beta"]) for row in rows}
    except (OSError, ValueError, KeyError):
        return {}
