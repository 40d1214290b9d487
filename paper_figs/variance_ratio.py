"""Forecast variance / true variance over the horizon, one figure for each environment.

    python -m paper_figs.variance_ratio results/paper

One panel for each model. Curves are medians over seeds and dimensions at each step, shaded areas
the ranges of dimensions, averaged over seeds. Thick lines are the aleatoric forecast variance /
true variance. Thin lines are the total forecast variance / true variance, for models with an
ensemble. The ensemble alone has no aleatoric variance, so its line is the total. The ideal ratio is
1. An aleatoric ratio above 1 that is higher where there is less data shows that a model counts
epistemic uncertainty twice. A step leaves out the dimensions with negligible true variance. The
oracle, in every panel, shows the variation by chance. A curve ends where a forecast is
not finite. Tables have one number for a curve, its median from step 11 on
(`study.metrics.variance`).
"""

import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from paper_figs.command import command
from paper_figs.scores import environments, levels, models, read_scores
from study.config.names import ORACLE, label
from study.metrics.tables.table import select
from study.metrics.variance import median_of_known
from study.plotting import style

ALEATORIC, TOTAL = "aleatoric_ratio", "variance_ratio"

LIMITS = (1e-3, 1e3)
"""Limits of the ratio's axis, for models that diverge."""

THIN = 0.5
"""Width of the lines of the total variance, in points."""


def plot(results: Path) -> list[Path]:
    """Write figures/variance_<environment>.png and .pdf into `results`.

    Raises:
        BadInput: there are no scores.
    """
    scores = read_scores(results)
    ratios = scores[
        scores["metric"].isin([ALEATORIC, TOTAL])
        & (scores["dimension"] != "all")
        & (scores["step"] > 0)
    ]
    written = []
    for environment in environments(ratios):
        stem = results / "figures" / f"variance_{environment}"
        part = ratios[ratios["environment"] == environment]
        written += _plot_environment(part, environment, stem)
    return written


def _plot_environment(scores: pd.DataFrame, environment: str, stem: Path) -> list[Path]:
    palette = style.colours(models(scores))
    shown = [model for model in models(scores) if model != ORACLE] or [ORACLE]
    rows = (len(shown) + 1) // 2
    with mpl.rc_context(style.context()):
        figure = style.figure(height=0.7 + 1.15 * rows)
        panels = figure.subplots(rows, 2, sharex=True, sharey=True, squeeze=False)
        for index, (model, axes) in enumerate(zip(shown, panels.flat, strict=False)):
            _panel(axes, scores, environment, model, palette)
            if index + 2 >= len(shown):
                axes.xaxis.set_tick_params(labelbottom=True)
                axes.set_xlabel("forecast step")
        for axes in panels.flat[len(shown) :]:
            axes.set_visible(False)
        _scales(panels[0, 0])
        figure.supylabel(
            f"{label(environment)}: forecast / true variance",
            size=mpl.rcParams["axes.labelsize"],
        )
        _legend(figure, scores)
        return style.save(figure, stem)


def _panel(
    axes: Axes, scores: pd.DataFrame, environment: str, model: str, palette: dict[str, str]
) -> None:
    axes.axhline(1, color="black", linewidth=0.5)
    for level in levels(scores):
        line_style = style.line("", level)
        aleatoric, total = (
            _by_step(scores, metric, environment, level, model) for metric in (ALEATORIC, TOTAL)
        )
        thick = total if aleatoric.empty else aleatoric
        if thick.empty:
            continue
        _range(axes, thick, palette[model])
        _curve(axes, thick, color=palette[model], **line_style)
        if not aleatoric.empty and not np.allclose(aleatoric, total, equal_nan=True):
            thin = line_style | {"linewidth": THIN}
            _curve(axes, total, color=palette[model], **thin)
    reference = _by_step(scores, TOTAL, environment, levels(scores)[0], ORACLE)
    if not reference.empty:
        line = style.line(ORACLE, "low")
        _curve(axes, reference, color=palette[ORACLE], **line)
    axes.set_title(label(model), loc="left", color=palette[model])


def _by_step(
    scores: pd.DataFrame, metric: str, environment: str, level: str, model: str
) -> pd.DataFrame:
    """Ratios, seeds and dimensions × steps; empty for a cell without scores."""
    table = select(scores, metric, environment, level, model, by="dimension and step")
    return table if table.empty else pd.DataFrame(table.stack("dimension", future_stack=True))


def _curve(axes: Axes, values: pd.DataFrame, **line: Any) -> None:
    """Plot the median at each step, over seeds and dimensions."""
    axes.plot(values.columns, [median_of_known(v) for v in values.to_numpy().T], **line)


def _range(axes: Axes, values: pd.DataFrame, colour: str) -> None:
    values = values.groupby(level="dimension").mean()
    if len(values) > 1:
        axes.fill_between(
            values.columns, values.min(), values.max(), color=colour, alpha=0.13, linewidth=0
        )


def _scales(axes: Axes) -> None:
    """Set the scales, which all panels share."""
    axes.set_yscale("log", nonpositive="clip")
    low, high = axes.get_ylim()
    axes.set_ylim(max(low, LIMITS[0]), min(high, LIMITS[1]))
    axes.yaxis.set_major_locator(LogLocator(10, numticks=10))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))
    axes.set_xlim(left=0)


def _legend(figure: Figure, scores: pd.DataFrame) -> None:
    handles: list[Line2D | Patch] = [
        Line2D(
            [], [], color="black", label=label(level), **style.line("", level) | {"linewidth": 1}
        )
        for level in levels(scores)
    ]
    if (scores["metric"] == ALEATORIC).any():
        handles += [
            Line2D([], [], color="black", linewidth=1.5, label="aleatoric (median)"),
            Line2D([], [], color="black", linewidth=THIN, label="total (median)"),
        ]
    handles.append(Patch(color="black", alpha=0.13, linewidth=0, label="range of dimensions"))
    if (scores["model"] == ORACLE).any():
        colour = style.COLOURS[ORACLE]
        handles.append(Line2D([], [], color=colour, label="oracle", **style.line(ORACLE, "low")))
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=3,
        handlelength=1.6,
        columnspacing=1.0,
        handletextpad=0.5,
    )


if __name__ == "__main__":
    sys.exit(command(plot, "Forecast variance / true variance over the horizon."))
