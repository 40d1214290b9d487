"""The recording of a whole study: every cell's discrepancy in one plot, and what it comes to."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import rerun as rr

from study.config.names import (
    ENSEMBLE,
    FULL,
    FULL_CRPS,
    FULL_ENSEMBLE,
    MLP,
    MLP_ENSEMBLE,
    ORACLE,
    RESIDUAL,
    RESIDUAL_CRPS,
    RESIDUAL_ENSEMBLE,
    label,
)
from study.plotting.palette import REFERENCE, Colour, faint, model_colours
from study.recording import blueprints
from study.recording.properties import Properties, table, write_markdown, write_readme
from study.recording.streams import entity_path, finite, recording, send_scalars, style_lines

KIND = "study"
TIMELINE = "horizon"
# Of each cell these are told, from left to right: what they are called, and how written.
_MAIN = {
    "mmd2": ("MMD²", ".4f"),
    "brier": ("Brier", ".3f"),
    "energy_score": ("energy score", ".3f"),
    "crps": ("CRPS", ".3f"),
    "coverage_90": ("coverage of 90 %", ".3f"),
    "variance_ratio": ("variance ratio", ".3g"),
}
# The MMD² of right forecasts that are shifted by so much; it comes with the oracle's scores.
_RULER = {f"mmd2_shift_{shift}": f"ruler: {shift} sd" for shift in ("0.1", "0.3", "1")}
_COLOURS = {
    RESIDUAL: "blue",
    FULL: "orange",
    MLP: "green",
    RESIDUAL_CRPS: "light blue",
    FULL_CRPS: "yellow",
    RESIDUAL_ENSEMBLE: "indigo",
    FULL_ENSEMBLE: "wine",
    MLP_ENSEMBLE: "olive",
    ENSEMBLE: "pink",
    ORACLE: "grey",
}
_README = """
# The whole study

**MMD²** compares what a model forecasts with what was observed from the same beginning, at each
step of the horizon, averaged over dimensions of the state and scenarios. Lower is better; 0 if the
two distributions are the same.

- **Thick**: trained on all data (low epistemic uncertainty).
- **Thin and faint**: trained on a part of it (high).
- **oracle**: the simulator itself run again, which is the floor.
- **ruler**: right forecasts, shifted by 0.1, 0.3 and 1 standard deviation of what was observed.
"""
_BELOW = """
Below the plots: {titles}. *Cells* names every cell's own recordings, which show how it came to its
scores.
"""
_CELLS = """
# Cells

MMD², Brier score, energy score and CRPS: lower is better. The coverage should be 0.9, and the
variance ratio (forecast over observed) 1.

A cell's recordings lie in the folder of its name, beside this one: `rerun CELL/KIND.rrd`, or
`python -m study.run view CELL --kind KIND`. Those of the training data are `ENVIRONMENT/data.rrd`,
or `python -m study.run view ENVIRONMENT`.
"""


class _Cell(NamedTuple):
    """What identifies a cell in the scores."""

    environment: str
    level: str
    model: str
    seed: int

    @property
    def parts(self) -> tuple[str, ...]:
        return self.environment, self.level, self.model, f"seed-{self.seed}"

    @property
    def name(self) -> str:
        return "/".join(self.parts)


def record_study(
    path: Path, scores: pd.DataFrame, texts: Mapping[str, str], properties: Properties
) -> None:
    """Write the recording of a study.

    `/mmd2/CELL` holds the cell's MMD² on the timeline `horizon`, `/ruler/ENVIRONMENT/…` its ruler,
    and `/overall/METRIC` a column a cell, at step 0. Recordings of the cells that lie beside
    `path`, in folders of their names, are linked by name.

    Args:
        path: the recording.
        scores: the tidy scores of all cells, as in ``scores.parquet``.
        texts: Markdown of the panels below the plots, by title.
        properties: of the recording.
    """
    whole = scores[(scores["dimension"] == "all") & (scores["scenario"] == -1)]
    cells = _cells(whole)
    curves = whole[whole["step"] > 0]
    overall = _overall(whole[whole["step"] == -1], cells)
    texts = {**texts, "Cells": _cells_text(overall, path.parent)}
    panels = {title: entity_path("text", title) for title in texts}
    horizons = {str(name): int(rows.max()) for name, rows in curves.groupby("environment")["step"]}
    design = blueprints.study(_plots(cells), horizons, _span(curves), panels)
    with recording(path, KIND, properties, design) as stream:
        below = _BELOW.format(titles=", ".join(f"*{title}*" for title in texts))
        write_readme(stream, _README + _colours_text(cells) + below, properties)
        for title, text in texts.items():
            # The viewer's Markdown knows no HTML.
            write_markdown(stream, panels[title], text.replace("<br>", " · "))
        colours = model_colours(cell.model for cell in cells)
        _log_curves(stream, curves, cells, colours)
        _log_ruler(stream, curves)
        for metric in overall.columns:
            entity = entity_path("overall", str(metric))
            style = [colours[cell.model] for cell in cells]
            style_lines(stream, entity, [cell.name for cell in cells], style)
            send_scalars(stream, entity, TIMELINE, [0], finite(overall[[metric]].to_numpy().T))


def _log_curves(
    stream: rr.RecordingStream,
    curves: pd.DataFrame,
    cells: list[_Cell],
    colours: Mapping[str, Colour],
) -> None:
    """The MMD² of each cell by step; the level is told by the line, the model by the colour."""
    seeds = len({cell.seed for cell in cells}) > 1
    for cell, entity in _entities(cells).items():
        rows = curves[_is(curves, cell) & (curves["metric"] == "mmd2")].sort_values("step")
        send_scalars(stream, entity, TIMELINE, rows["step"], finite(rows["value"].to_numpy()))
        bold = cell.level == "low" or cell.model == ORACLE
        colour = colours[cell.model] if bold else faint(colours[cell.model], 190)
        style_lines(stream, entity, [_line(cell, seeds)], [colour], 2.5 if bold else 1.2)


def _log_ruler(stream: rr.RecordingStream, curves: pd.DataFrame) -> None:
    """By environment and step, averaged over seeds."""
    ruler = curves[curves["metric"].isin(_RULER)]
    for (environment, metric), rows in ruler.groupby(["environment", "metric"]):
        mean = rows.groupby("step")["value"].mean()
        entity = entity_path("ruler", str(environment), str(metric))
        send_scalars(stream, entity, TIMELINE, mean.index, finite(mean.to_numpy()))
        style_lines(stream, entity, [_RULER[str(metric)]], [REFERENCE], 0.8)


def _cells(whole: pd.DataFrame) -> list[_Cell]:
    """The cells that have scores, in the order of the table."""
    rows = whole[list(_Cell._fields)].drop_duplicates()
    return [
        _Cell(str(environment), str(level), str(model), int(seed))
        for environment, level, model, seed in rows.itertuples(index=False)
    ]


def _is(rows: pd.DataFrame, cell: _Cell) -> "pd.Series[bool]":
    """Which rows are the cell's."""
    return (
        (rows["environment"] == cell.environment)
        & (rows["level"] == cell.level)
        & (rows["model"] == cell.model)
        & (rows["seed"] == cell.seed)
    )


def _entities(cells: Iterable[_Cell]) -> dict[_Cell, str]:
    """Where each cell's curve is."""
    return {cell: entity_path("mmd2", *cell.parts) for cell in cells}


def _plots(cells: list[_Cell]) -> dict[str, list[str]]:
    """The curves of each environment's plot; the oracle is the same at both levels, so shown once.

    No line covers another that is more to the point: the ruler lies below all.
    """
    plots: dict[str, list[str]] = {}
    seen = set()
    for cell, entity in _entities(cells).items():
        curves = plots.setdefault(
            cell.environment,
            [entity_path("ruler", cell.environment, metric) for metric in _RULER],
        )
        same = cell._replace(level="") if cell.model == ORACLE else cell
        if same not in seen:
            curves.append(entity)
        seen.add(same)
    return plots


def _span(curves: pd.DataFrame) -> tuple[float, float]:
    """The range of all plots: from below the oracle, which may dip below 0, to above all curves."""
    values = finite(curves.loc[curves["metric"] == "mmd2", "value"].to_numpy())
    top = float(np.nanmax(values, initial=1e-3))
    return -0.05 * top, 1.05 * top


def _line(cell: _Cell, seeds: bool) -> str:
    """What the legend calls a cell's curve."""
    words = [label(cell.model), *([] if cell.model == ORACLE else [cell.level])]
    return ", ".join([*words, f"seed {cell.seed}"] if seeds else words)


def _overall(rows: pd.DataFrame, cells: list[_Cell]) -> pd.DataFrame:
    """A row a cell, by its name, a column a metric; NaN where a cell lacks it."""
    metrics = [metric for metric in _MAIN if (rows["metric"] == metric).any()]
    wide = rows[rows["metric"].isin(metrics)].pivot(
        index=list(_Cell._fields), columns="metric", values="value"
    )
    ordered = wide.reindex(index=pd.MultiIndex.from_tuples(cells), columns=metrics)
    return ordered.set_axis([cell.name for cell in cells])


def _colours_text(cells: Iterable[_Cell]) -> str:
    """Which colour is which model."""
    models = dict.fromkeys(cell.model for cell in cells)
    named = [f"{_COLOURS[model]} *{label(model)}*" for model in models if model in _COLOURS]
    return f"\nColours: {', '.join(named)}.\n" if named else ""


def _cells_text(overall: pd.DataFrame, folder: Path) -> str:
    """The cells with their main scores, and the names of their recordings."""
    metrics = [str(metric) for metric in overall.columns]
    header = ("cell", *(_MAIN[metric][0] for metric in metrics), "recordings")
    forms = [_MAIN[metric][1] for metric in metrics]
    rows = []
    for name, values in zip(overall.index, overall.to_numpy(), strict=True):
        kinds = sorted(file.stem for file in (folder / str(name)).glob("*.rrd"))
        numbers = [f"{value:{form}}" for value, form in zip(values, forms, strict=True)]
        rows.append((str(name), *numbers, ", ".join(kinds) or "none"))
    return f"{_CELLS}\n{table(header, rows)}\n"
