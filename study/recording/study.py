"""``study.rrd``: the MMD² of every cell over the horizon, with the tables and the claims."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import rerun as rr

from study.config.names import FROM_DATA, ORACLE, label
from study.metrics.variance import FIRST_STEP, median_ratio
from study.plotting.lines import line_of
from study.plotting.palette import REFERENCE, Colour, faint, model_colour_names, model_colours
from study.recording import blueprints
from study.recording.properties import Properties, table, write_markdown, write_readme
from study.recording.streams import entity_path, finite, recording, send_scalars, style_lines

KIND = "study"
TIMELINE = "horizon"
# The metrics in the table of cells: title and number format.
_METRICS = {
    "mmd2": ("MMD²", ".4f"),
    "brier": ("Brier", ".3f"),
    "energy_score": ("energy score", ".3f"),
    "crps": ("CRPS", ".3f"),
    "coverage_90": ("coverage of 90 %", ".3f"),
    "variance_ratio": ("variance ratio", ".3g"),
}
_RATIO = "variance_ratio"
# The MMD² of the oracle's forecasts, shifted by some standard deviations.
_SHIFTS = {f"mmd2_shift_{shift}": f"shift of {shift} sd" for shift in ("0.1", "0.3", "1")}
# Line width in the viewer for a line width of 1 in a figure, and the opacity of dashed lines.
_SCALE = 5 / 3
_DASHED = 190
_README = """
# The whole study

A *cell* is one model, trained on one environment at one level of epistemic uncertainty, with one
seed. Each line shows the **MMD²** of a cell over the horizon, averaged over scenarios and over the
dimensions of the state. MMD², the maximum mean discrepancy, compares forecast and observed states
after the same actions. Lower is better: it is 0 if both have the same distribution. An estimate can
fall below 0 by chance.

The panel *Legend* names the colours. Some lines are references to compare with:

- *Oracle*: forecasts by the simulator itself. In expectation, no model can be better.
- *Ensemble alone*: the recurrent networks without a model of the noise.
- *Shift of 0.1, 0.3 and 1 sd*, for scale: the MMD² of correct forecasts, shifted by that many
  standard deviations of the observed states.
"""
_ONCE = """
A recorded system was observed once in each scenario. So it has no oracle and no shifts. Its MMD² is
that against one observation: lower is better, but the lowest value is not 0. Its references
forecast from the training windows: *training climatology* (random windows), *persistence* (the
initial state with the changes of random windows), and *analogues* (the windows that began most
alike and had the most similar actions).
"""
_LINES = """
Thick: level low, trained on all data. Thin: other levels, trained on a part of the data. Faint
grey: the MMD² of correct forecasts, shifted by 0.1, 0.3 and 1 standard deviation.
"""
_BELOW = """
Below the plots: {titles}. *Cells* names the recordings of each cell.
"""
_CELLS = """
# Cells

MMD², plain Brier score, energy score and CRPS: lower is better. The coverage should be 0.9. The
variance ratio should be 1. It is forecast variance over observed variance: the median over
dimensions and over the steps from {first} on.

The recordings of a cell are beside this one, in the folder of its name: `rerun CELL/KIND.rrd`, or
`python -m study.run view CELL --kind KIND`. The training data of an environment are in
`ENVIRONMENT/data.rrd`; `python -m study.run view ENVIRONMENT` opens them.
"""


class _Cell(NamedTuple):
    """The columns that identify a cell in the scores."""

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

    `/mmd2/CELL` holds the MMD² of a cell on the timeline `horizon`, and
    `/reference_shift/ENVIRONMENT/…` the MMD² of shifted forecasts. `/overall/METRIC` holds one
    column for each cell, at step 0.

    Args:
        path: the recording. The panel *Cells* lists the recordings of cells beside it.
        scores: the tidy scores of all cells, as in ``scores.parquet``.
        texts: Markdown of the panels below the plots, by title.
        properties: of the recording.
    """
    averaged = scores[(scores["dimension"] == "all") & (scores["scenario"] == -1)]
    cells = _cells(averaged)
    curves = averaged[averaged["step"] > 0]
    overall = _overall(averaged[averaged["step"] == -1], cells)
    if _RATIO in overall:
        overall[_RATIO] = _median_ratios(scores, cells)
    texts = {**texts, "Cells": _cells_text(overall, path.parent)}
    panels = {title: entity_path("text", title) for title in texts}
    horizons = {str(name): int(rows.max()) for name, rows in curves.groupby("environment")["step"]}
    design = blueprints.study(_plots(cells), horizons, _span(curves), panels)
    with recording(path, KIND, properties, design) as stream:
        below = _BELOW.format(titles=", ".join(f"*{title}*" for title in texts))
        has_recorded = any(cell.model in FROM_DATA for cell in cells)
        readme = _README + (_ONCE if has_recorded else "") + below
        write_readme(stream, readme, properties)
        write_markdown(stream, blueprints.LEGEND, _legend_text(cells))
        for title, text in texts.items():
            # The Markdown of the viewer does not support HTML.
            write_markdown(stream, panels[title], text.replace("<br>", " · "))
        colours = model_colours(cell.model for cell in cells)
        _log_curves(stream, curves, cells, colours)
        _log_shifts(stream, curves)
        for metric in overall.columns:
            entity = entity_path("overall", str(metric))
            cell_colours = [colours[cell.model] for cell in cells]
            style_lines(stream, entity, [cell.name for cell in cells], cell_colours)
            send_scalars(stream, entity, TIMELINE, [0], finite(overall[[metric]].to_numpy().T))


def _log_curves(
    stream: rr.RecordingStream,
    curves: pd.DataFrame,
    cells: list[_Cell],
    colours: Mapping[str, Colour],
) -> None:
    """Log the MMD² of each cell by step: the line shows the level, the colour the model."""
    seeds = len({cell.seed for cell in cells}) > 1
    for cell, entity in _entities(cells).items():
        rows = curves[_is(curves, cell) & (curves["metric"] == "mmd2")].sort_values("step")
        send_scalars(stream, entity, TIMELINE, rows["step"], finite(rows["value"].to_numpy()))
        line, colour = line_of(cell.model, cell.level), colours[cell.model]
        if line.dashes:
            colour = faint(colour, _DASHED)
        style_lines(stream, entity, [_curve_name(cell, seeds)], [colour], _SCALE * line.width)


def _log_shifts(stream: rr.RecordingStream, curves: pd.DataFrame) -> None:
    """Log the MMD² of shifted forecasts by environment and step, averaged over seeds."""
    shifts = curves[curves["metric"].isin(_SHIFTS)]
    for (environment, metric), rows in shifts.groupby(["environment", "metric"]):
        mean = rows.groupby("step")["value"].mean()
        entity = entity_path("reference_shift", str(environment), str(metric))
        send_scalars(stream, entity, TIMELINE, mean.index, finite(mean.to_numpy()))
        style_lines(stream, entity, [_SHIFTS[str(metric)]], [REFERENCE], 0.8)


def _cells(scores: pd.DataFrame) -> list[_Cell]:
    """The cells that have scores, in the order of the scores."""
    rows = scores[list(_Cell._fields)].drop_duplicates()
    return [
        _Cell(str(environment), str(level), str(model), int(seed))
        for environment, level, model, seed in rows.itertuples(index=False)
    ]


def _is(rows: pd.DataFrame, cell: _Cell) -> "pd.Series[bool]":
    """Which rows belong to the cell."""
    return (
        (rows["environment"] == cell.environment)
        & (rows["level"] == cell.level)
        & (rows["model"] == cell.model)
        & (rows["seed"] == cell.seed)
    )


def _entities(cells: Iterable[_Cell]) -> dict[_Cell, str]:
    """The entity of each cell's curve."""
    return {cell: entity_path("mmd2", *cell.parts) for cell in cells}


def _plots(cells: list[_Cell]) -> dict[str, list[str]]:
    """The entities of each environment's plot, in the order in which the viewer draws them.

    The reference shifts come first, so that they are behind the models. The oracle is the same at
    all levels, so the plot shows it once.
    """
    plots: dict[str, list[str]] = {}
    included = set()
    for cell, entity in _entities(cells).items():
        curves = plots.setdefault(
            cell.environment,
            [entity_path("reference_shift", cell.environment, metric) for metric in _SHIFTS],
        )
        distinct = cell._replace(level="") if cell.model == ORACLE else cell
        if distinct not in included:
            curves.append(entity)
        included.add(distinct)
    return plots


def _span(curves: pd.DataFrame) -> tuple[float, float]:
    """The y axis of all plots: from slightly below 0, since estimates can be negative."""
    values = finite(curves.loc[curves["metric"] == "mmd2", "value"].to_numpy())
    top = float(np.nanmax(values, initial=1e-3))
    return -0.05 * top, 1.05 * top


def _curve_name(cell: _Cell, seeds: bool) -> str:
    """The name of a cell's curve in the legend."""
    words = [label(cell.model), *([] if cell.model == ORACLE else [cell.level])]
    return ", ".join([*words, f"seed {cell.seed}"] if seeds else words)


def _overall(rows: pd.DataFrame, cells: list[_Cell]) -> pd.DataFrame:
    """A table with a row for each cell and a column for each metric; NaN for a missing score."""
    metrics = [metric for metric in _METRICS if (rows["metric"] == metric).any()]
    wide = rows[rows["metric"].isin(metrics)].pivot(
        index=list(_Cell._fields), columns="metric", values="value"
    )
    ordered = wide.reindex(index=pd.MultiIndex.from_tuples(cells), columns=metrics)
    return ordered.set_axis([cell.name for cell in cells])


def _median_ratios(scores: pd.DataFrame, cells: list[_Cell]) -> list[float]:
    """The variance ratio of each cell, as in the tables."""
    ratios = scores[(scores["metric"] == _RATIO) & (scores["dimension"] != "all")]
    ratios = ratios[ratios["step"] > 0]
    return [
        median_ratio(rows["value"].to_numpy(), rows["step"].to_numpy())
        for rows in (ratios[_is(ratios, cell)] for cell in cells)
    ]


def _legend_text(cells: Iterable[_Cell]) -> str:
    """The colour of each model, in words, and the meaning of the lines."""
    models = list(dict.fromkeys(cell.model for cell in cells))
    names = model_colour_names(models)
    listed = "\n".join(f"- {names[model]}: **{label(model)}**" for model in models)
    return f"{listed}\n{_LINES}"


def _cells_text(overall: pd.DataFrame, folder: Path) -> str:
    """A table of the cells, with their main scores and the kinds of their recordings."""
    metrics = [str(metric) for metric in overall.columns]
    header = ("cell", *(_METRICS[metric][0] for metric in metrics), "recordings")
    forms = [_METRICS[metric][1] for metric in metrics]
    rows = []
    for name, values in zip(overall.index, overall.to_numpy(), strict=True):
        kinds = sorted(file.stem for file in (folder / str(name)).glob("*.rrd"))
        numbers = [f"{value:{form}}" for value, form in zip(values, forms, strict=True)]
        rows.append((str(name), *numbers, ", ".join(kinds) or "none"))
    return f"{_CELLS.format(first=FIRST_STEP)}\n{table(header, rows)}\n"
