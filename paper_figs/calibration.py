"""Coverage over the horizon and PIT histograms, one figure for each environment.

    python -m paper_figs.calibration results/paper

Upper row: coverage, the share of observed rollouts within the central 50, 80 and 90 % of the
forecasts, averaged over scenarios, state dimensions and seeds. The black line is the nominal
coverage. Lower row: PIT histograms over the whole horizon (`study.metrics.calibration`). A density
of 1 is calibrated. High densities at both ends show a forecast variance that is too small, or a
bias.
"""

import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from paper_figs.command import command
from paper_figs.scores import environments, levels, models, read_scores
from study.config.names import ORACLE, label
from study.metrics.tables.table import select
from study.plotting import style

INTERVALS = (50, 80, 90)
"""Probabilities of the central intervals, in per cent."""

DENSITIES = (0, 0.5, 1, 2, 4, 7, 10)
"""Ticks of the PIT histograms."""


def plot(results: Path) -> list[Path]:
    """Write figures/calibration_<environment>.png and .pdf into `results`.

    Environments without scores of coverage have no figure.

    Raises:
        BadInput: there are no scores.
    """
    scores = read_scores(results)
    metric = scores["metric"]
    rows = scores[
        (metric.str.startswith("coverage_") | metric.str.startswith("pit_"))
        & (scores["dimension"] == "all")
        & (scores["scenario"] == -1)
    ]
    written = []
    for environment in environments(rows):
        stem = results / "figures" / f"calibration_{environment}"
        part = rows[rows["environment"] == environment]
        written += _plot_environment(part, environment, stem)
    return written


def _plot_environment(scores: pd.DataFrame, environment: str, stem: Path) -> list[Path]:
    palette = style.colours(models(scores))
    with mpl.rc_context(style.context()):
        figure = style.figure(height=3.4)
        above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=[1.25, 1])[:, 0]
        _coverage(above, scores, environment, palette)
        _histograms(below, scores, environment, palette)
        _legend(figure, scores, palette)
        return style.save(figure, stem)


def _cells(scores: pd.DataFrame, model: str) -> list[str]:
    """The levels at which a model is plotted; the oracle is the same at all levels."""
    return levels(scores)[:1] if model == ORACLE else levels(scores)


def _coverage(
    part: SubFigure, scores: pd.DataFrame, environment: str, palette: dict[str, str]
) -> None:
    panels = part.subplots(1, len(INTERVALS), sharex=True, sharey=True)
    for interval, axes in zip(INTERVALS, panels, strict=True):
        axes.axhline(interval / 100, color="black", linewidth=0.6)
        for model in models(scores):
            for level in _cells(scores, model):
                coverage = select(
                    scores, f"coverage_{interval}", environment, level, model, by="step"
                ).mean()
                axes.plot(coverage.index, coverage, color=palette[model], **_line(model, level))
        axes.set_title(f"central {interval} %", loc="left")
    panels[0].set(ylim=(0, 1), ylabel=f"{label(environment)}: coverage")
    panels[0].set_xlim(left=0)
    panels[0].xaxis.set_major_locator(MaxNLocator(3, integer=True))
    panels[1].set_xlabel("forecast step")


def _histograms(
    part: SubFigure, scores: pd.DataFrame, environment: str, palette: dict[str, str]
) -> None:
    metrics = sorted(m for m in scores["metric"].unique() if m.startswith("pit_"))
    panels = part.subplots(1, len(models(scores)), sharex=True, sharey=True, squeeze=False)[0]
    for model, axes in zip(models(scores), panels, strict=True):
        axes.axhline(1, color="black", linewidth=0.6)
        for level in _cells(scores, model):
            shares = _shares(scores, metrics, environment, level, model)
            if shares is not None:
                axes.step(
                    np.linspace(0, 1, len(metrics) + 1),
                    np.append(shares, shares[-1]) * len(metrics),
                    where="post",
                    color=palette[model],
                    **_line(model, level),
                )
        _frame(axes)
    panels[0].set_ylabel("density")
    panels[len(panels) // 2].set_xlabel("PIT (rank of the observation among the forecasts)")


def _shares(
    scores: pd.DataFrame, metrics: list[str], environment: str, level: str, model: str
) -> np.ndarray | None:
    """The share of each bin, averaged over seeds; None for a cell without scores."""
    rows = [
        scores[
            (scores["metric"] == metric)
            & (scores["environment"] == environment)
            & (scores["level"] == level)
            & (scores["model"] == model)
        ]["value"]
        for metric in metrics
    ]
    return None if rows[0].empty else np.array([row.mean() for row in rows])


def _frame(axes: Axes) -> None:
    axes.set_xlim(0, 1)
    axes.set_xticks([0, 0.5, 1], ["0", "½", "1"])
    # A square-root scale can show zero, and high densities at the ends do not hide the rest.
    axes.set_yscale("function", functions=(np.sqrt, np.square))
    axes.set_yticks(DENSITIES, [f"{density:g}" for density in DENSITIES])
    axes.set_ylim(bottom=0)


def _line(model: str, level: str) -> dict[str, Any]:
    """The line of a model at a level, thinner than in larger panels."""
    line = style.line(model, level)
    return line | {"linewidth": 0.7 * line["linewidth"]}


def _legend(figure: Figure, scores: pd.DataFrame, palette: dict[str, str]) -> None:
    handles = [
        Line2D([], [], color=palette[model], label=label(model), **style.line(model, "low"))
        for model in models(scores)
    ]
    handles += [
        Line2D([], [], color="black", label=label(level), **style.line("", level))
        for level in levels(scores)
    ]
    handles.append(Line2D([], [], color="black", linewidth=0.6, label="calibrated"))
    ncols = style.columns(handles)
    figure.legend(handles=handles, loc="outside lower center", ncols=ncols, handlelength=2.2)


if __name__ == "__main__":
    sys.exit(command(plot, "Coverage over the horizon and PIT histograms."))
