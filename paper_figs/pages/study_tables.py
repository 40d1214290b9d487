"""The tables of the front page and of the report, from the committed results of a study."""

from collections.abc import Callable
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from paper_figs.formatting import number, signed, title
from paper_figs.pages.marks import pipe_table
from paper_figs.scores import read_scores, rollouts
from study.claims.paper import BRIER
from study.common.arrays import Doubles
from study.common.errors import BadInput
from study.common.files import read_json
from study.config.names import (
    BEYOND,
    ENSEMBLE,
    ENVIRONMENTS,
    FULL,
    FULL_CRPS,
    LEVELS,
    MLP,
    MODELS,
    ORACLE,
    RESIDUAL,
    label,
)
from study.metrics.brier import brier_oracle, skill
from study.metrics.intervals import difference
from study.metrics.tables.table import select
from study.metrics.variance import median_ratio

CELLS = [(environment, level) for environment in ENVIRONMENTS for level in LEVELS]
METRICS = {"mmd2": "MMD²", "brier": "plain Brier score"}
CONTRASTS = (
    (FULL, RESIDUAL),
    (MLP, RESIDUAL),
    (FULL_CRPS, RESIDUAL),
)
"""Differences that the report discusses: the first model minus the second."""
CLIMATOLOGY = "climatology"


class Study:
    """The numbers in the results folder of a study. Each file is read once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @cached_property
    def scores(self) -> pd.DataFrame:
        """The rows of ``scores.parquet`` that the tables need."""
        scores = read_scores(self._folder)
        averaged = (scores["step"] == -1) & (scores["dimension"] == "all")
        metrics = ["mmd2", "brier", "brier_fair", "brier_climatology", "observed_probability"]
        return scores[
            (scores["metric"].isin(metrics) & averaged) | (scores["metric"] == "variance_ratio")
        ]

    @cached_property
    def rollouts(self) -> int:
        """Observed rollouts of each scenario."""
        observed = rollouts(self._folder)
        if observed is None:
            raise BadInput(f"{self._folder / 'study.json'} lacks the setting collect.rollouts")
        return observed

    @cached_property
    def trials(self) -> pd.DataFrame:
        """``trials.parquet``: the searches for β."""
        return pd.read_parquet(self._folder / "trials.parquet")

    @cached_property
    def timings(self) -> pd.DataFrame:
        """``timings.json``: a row for each task, with its stage, model and environment."""
        times = read_json(self._folder / "timings.json")
        rows = [
            {
                "stage": task.split()[0],
                "environment": task.split()[1].split("/")[0],
                "model": (task.split("/") + [""] * 3)[2],
                "cpu": seconds,
                "memory": times["peak_memory"][task],
            }
            for task, seconds in times["cpu_seconds"].items()
        ]
        return pd.DataFrame(rows)

    @cached_property
    def models(self) -> list[str]:
        """The models that were trained, the paper's first."""
        present = set(self.scores["model"])
        return [model for model in (*MODELS, *BEYOND) if model in present]

    def values(self, metric: str, environment: str, level: str, model: str) -> Doubles:
        """One metric of one cell: [seeds, S]."""
        if model == CLIMATOLOGY:
            metric, model = "brier_climatology", ORACLE
        return select(self.scores, metric, environment, level, model).to_numpy(np.float64)

    def paired(
        self, metric: str, environment: str, level: str, first: str, second: str
    ) -> tuple[Doubles, Doubles]:
        """One metric of two models, on the seeds that both have: [seeds, S] each."""
        one, other = (
            select(self.scores, metric, environment, level, model) for model in (first, second)
        )
        seeds = one.index.intersection(other.index)
        return one.loc[seeds].to_numpy(np.float64), other.loc[seeds].to_numpy(np.float64)

    def mean(self, metric: str, environment: str, level: str, model: str) -> float:
        """The mean over seeds and scenarios."""
        return float(self.values(metric, environment, level, model).mean())

    def skill(self, environment: str, level: str, model: str) -> float:
        """The skill of the fair Brier score: 0 is the climatology, 1 the oracle."""
        cell = (environment, level)
        observed = self.values("observed_probability", *cell, model)[0]
        return skill(
            self.mean("brier_fair", *cell, model),
            float(brier_oracle(observed, self.rollouts).mean()),
            self.mean("brier_climatology", *cell, model),
        )

    def variance_ratio(
        self, environment: str, level: str, model: str, dimension: str | None = None
    ) -> float:
        """Forecast variance / true variance: `study.metrics.variance.median_ratio`."""
        ratios = select(
            self.scores, "variance_ratio", environment, level, model, by="dimension and step"
        )
        if dimension:
            ratios = ratios[[dimension]]
        return median_ratio(ratios.to_numpy(), ratios.columns.get_level_values("step").to_numpy())


def tables(results: Path) -> dict[str, Callable[[], str]]:
    """The functions that write the tables, by name.

    Args:
        results: the folder with the committed results, ``results/`` of the repository.
    """
    study = Study(results / "paper")
    return {
        "answer": lambda: answer(study),
        "brier": lambda: scores(study, "brier", [*study.models, ENSEMBLE, ORACLE, CLIMATOLOGY]),
        "mmd": lambda: scores(study, "mmd2", [*study.models, ENSEMBLE, ORACLE]),
        "seeds": lambda: seeds(study),
        "differences-mmd": lambda: differences(study, "mmd2"),
        "differences-brier": lambda: differences(study, "brier"),
        "skill": lambda: measure(study, study.skill, [*study.models, ENSEMBLE]),
        "variance": lambda: measure(study, study.variance_ratio, [*study.models, ENSEMBLE, ORACLE]),
        "vertical": lambda: vertical(study),
        "beta": lambda: beta(study),
        "fit-seconds": lambda: fit_seconds(study),
        "stages": lambda: stages(study),
    }


def answer(study: Study) -> str:
    """MMD² and Brier score of each cell, with the paper's Brier scores in brackets."""
    models = [*MODELS, FULL_CRPS, ORACLE]
    rows = [
        [f"{name}, {_name(cell)}", *_entries(study, metric, cell, models)]
        for metric, name in METRICS.items()
        for cell in CELLS
    ]
    return pipe_table(["", *(label(model) for model in models)], rows)


def scores(study: Study, metric: str, models: list[str]) -> str:
    """One metric by cell and model."""
    rows = [[_name(cell), *_entries(study, metric, cell, models)] for cell in CELLS]
    return pipe_table(["", *(label(model) for model in models)], rows)


def _entries(study: Study, metric: str, cell: tuple[str, str], models: list[str]) -> list[str]:
    """The scores of one cell. The best of the paper's models is bold; brackets have its values."""
    means = {model: study.mean(metric, *cell, model) for model in models}
    best = min(MODELS, key=means.__getitem__)
    entries = []
    for model, mean in means.items():
        text = f"**{number(mean)}**" if model == best else number(mean)
        paper = BRIER.get((*cell, model)) if metric == "brier" else None
        entries.append(text if paper is None else f"{text} ({number(paper)})")
    return entries


def seeds(study: Study) -> str:
    """MMD² and Brier score of each training seed."""
    rows = [
        [f"{name}, {_name(cell)}"]
        + [
            ", ".join(number(mean) for mean in study.values(metric, *cell, model).mean(axis=1))
            for model in study.models
        ]
        for metric, name in METRICS.items()
        for cell in CELLS
    ]
    return pipe_table(["", *(label(model) for model in study.models)], rows)


def differences(study: Study, metric: str) -> str:
    """Differences between models, with intervals over the seeds that both have and scenarios."""
    rows = []
    for first, second in CONTRASTS:
        row = [f"{label(first)} − {label(second)}"]
        for cell in CELLS:
            interval = difference(*study.paired(metric, *cell, first, second))
            row.append(signed(interval.estimate, interval.low, interval.high, digits=3))
        rows.append(row)
    return pipe_table([METRICS[metric], *map(_name, CELLS)], rows)


def measure(study: Study, value: Callable[[str, str, str], float], models: list[str]) -> str:
    """A number of each cell and model, with two digits."""
    rows = [[_name(cell), *(number(value(*cell, m), 2) for m in models)] for cell in CELLS]
    return pipe_table(["", *(label(model) for model in models)], rows)


def vertical(study: Study) -> str:
    """Forecast variance / true variance of the UAV's height and vertical speed."""
    rows = [
        [f"{name}, {label(level)}"]
        + [number(study.variance_ratio("uav", level, m, dimension), 2) for m in study.models]
        for dimension, name in (("z", "height"), ("vz", "vertical speed"))
        for level in LEVELS
    ]
    return pipe_table(["", *(label(model) for model in study.models)], rows)


def beta(study: Study) -> str:
    """The β from each search, by training seed."""
    trials = study.trials[study.trials["chosen"]]
    rows = []
    for cell in CELLS:
        row = [_name(cell)]
        for model in (RESIDUAL, FULL):
            in_cell = (trials["environment"] == cell[0]) & (trials["level"] == cell[1])
            by_seed = trials[in_cell & (trials["model"] == model)].sort_values("seed")
            row.append(", ".join(f"{value:.1f}" for value in by_seed["beta"]))
        rows.append(row)
    return pipe_table(["β", label(RESIDUAL), label(FULL)], rows)


def fit_seconds(study: Study) -> str:
    """Processor seconds of a fit of each model with its search for β, averaged over the fits."""
    rows = []
    for environment in ENVIRONMENTS:
        timings = study.timings[study.timings["environment"] == environment]
        row = [label(environment)]
        for model in study.models:
            fits = timings[timings["stage"].isin(["tune", "train"]) & (timings["model"] == model)]
            row.append(f"{fits.groupby('stage')['cpu'].mean().sum():.0f}")
        members = timings[timings["stage"] == "ensemble"]["cpu"].mean()
        rows.append([*row, f"{members:.0f}"])
    return pipe_table(["", *(label(model) for model in study.models), "ensemble"], rows)


def stages(study: Study) -> str:
    """The cost of each stage of the study."""
    total = study.timings["cpu"].sum()
    rows = []
    for stage, tasks in study.timings.groupby("stage", sort=False):
        seconds, memory = tasks["cpu"].sum(), tasks["memory"].max() / 1e6
        share = f"{seconds / total:.0%}".replace("%", " %")
        rows.append([str(stage), str(len(tasks)), f"{seconds:,.0f}", share, f"{memory:,.0f}"])
    rows.append(["all", str(len(study.timings)), f"{total:,.0f}", "100 %", ""])
    heads = ["stage", "tasks", "processor seconds", "share", "peak memory, MB"]
    return pipe_table(heads, rows)


def _name(cell: tuple[str, str]) -> str:
    environment, level = cell
    return f"{title(environment)}, {label(level)}"
