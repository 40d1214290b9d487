"""Reliability diagrams of the goal, one figure for each environment.

    python -m paper_figs.reliability results/paper

A point is a bin of scenarios with similar forecast probabilities of success, at least ten for each
seed. It shows the observed frequency of success over the mean forecast
(`study.metrics.reliability`). Bars are 95 % t intervals over scenarios, for these seeds. A reliable
forecaster is on the diagonal. The dotted line is the base rate. In the shaded area forecasts are
better than the base rate (the attributes diagram of Hsu and Murphy 1986). Histograms of the
forecasts are below the diagram.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from paper_figs.command import command
from paper_figs.scores import environments, levels, models, read_scores
from study.common.arrays import Doubles
from study.config.names import ENSEMBLE, ORACLE, label
from study.metrics.intervals import training_seeds
from study.metrics.reliability import BINS, group_of, reliability_curve
from study.metrics.tables.table import select
from study.plotting import style

REFERENCES = (ENSEMBLE, ORACLE)
SHADE = "#EFEFE8"
STRIP = 0.12
"""Height of one histogram, in inches."""


@dataclass(frozen=True)
class Forecasts:
    """Forecast and observed probabilities of one model at one level."""

    probability: Doubles
    """[seeds, S]."""
    observed: Doubles
    """[S]."""


def plot(results: Path) -> list[Path]:
    """Write figures/reliability_<environment>.png and .pdf into `results`.

    Raises:
        BadInput: there are no scores.
    """
    scores = read_scores(results)
    rows = probabilities(scores)
    written = []
    for environment in environments(rows):
        stem = results / "figures" / f"reliability_{environment}"
        part = rows[rows["environment"] == environment]
        written += _plot_environment(part, environment, stem)
    return written


def probabilities(scores: pd.DataFrame) -> pd.DataFrame:
    """The rows of scores with the forecast and observed probabilities of success."""
    return scores[
        scores["metric"].isin(["forecast_probability", "observed_probability"])
        & (scores["scenario"] >= 0)
        & (scores["dimension"] == "all")
    ]


def _plot_environment(scores: pd.DataFrame, environment: str, stem: Path) -> list[Path]:
    palette = style.colours(models(scores))
    with mpl.rc_context(style.context()):
        level_names = levels(scores)
        cells = [forecasts_by_model(scores, environment, level) for level in level_names]
        present = [model for model in models(scores) if any(model in cell for cell in cells)]
        figure, panels, strips = _layout(len(level_names), len(present))
        for level, cell, panel, strip in zip(level_names, cells, panels, strips, strict=True):
            _background(panel, next(iter(cell.values())).observed.mean())
            for model, forecasts in cell.items():
                _curve(panel, forecasts, model, palette[model])
            _histograms(strip, [cell.get(m) for m in present], [palette[m] for m in present])
            separator = ", " if len(level_names) < 3 else ",\n"  # three titles need two lines each
            panel.set_title(f"{label(environment)}{separator}{label(level)}", loc="left")
        _legend(figure, present, palette, _counts(cells))
        return style.save(figure, stem)


def forecasts_by_model(scores: pd.DataFrame, environment: str, level: str) -> dict[str, Forecasts]:
    """The forecasts of each model with scores at this level."""
    forecasts = {}
    for model in models(scores):
        probability, observed = (
            select(scores, f"{which}_probability", environment, level, model).to_numpy(np.float64)
            for which in ("forecast", "observed")
        )
        if probability.size:
            forecasts[model] = Forecasts(probability, observed[0])
    return forecasts


def _layout(columns: int, rows: int) -> tuple[Figure, list[Axes], list[Axes]]:
    """One panel for each level, square if there are two, with a strip of histograms below."""
    figure = style.figure(height=2.8 + STRIP * rows)
    axes = figure.subplots(
        2, columns, sharex=True, sharey="row", squeeze=False, height_ratios=[1.6, STRIP * rows]
    )
    for strip in axes[1]:
        strip.set_xlabel("forecast probability")
    axes[0, 0].set_ylabel("observed frequency")
    axes[1, 0].set_ylabel("forecasts")
    return figure, list(axes[0]), list(axes[1])


def _background(axes: Axes, base: float) -> None:
    """Plot the diagonal, the base rate, and the area of forecasts better than the base rate."""
    ends = np.array([0.0, base, 1.0])
    halfway = (ends + base) / 2
    axes.fill_between(ends[:2], 0, halfway[:2], color=SHADE, linewidth=0, zorder=0)
    axes.fill_between(ends[1:], halfway[1:], 1, color=SHADE, linewidth=0, zorder=0)
    axes.plot([0, 1], [0, 1], color="black", linewidth=0.6, zorder=1)
    axes.axhline(base, color="black", linewidth=0.6, linestyle=":", zorder=1)
    axes.set(xlim=(0, 1), ylim=(0, 1))
    axes.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
    axes.set_yticks([0, 0.5, 1], ["0", "0.5", "1"])
    axes.grid(visible=False)


def _curve(axes: Axes, forecasts: Forecasts, model: str, colour: str) -> None:
    curve = reliability_curve(forecasts.probability, forecasts.observed)
    reference = model in REFERENCES
    if not reference:
        axes.vlines(curve.forecast, curve.low, curve.high, color=colour, linewidth=0.6, alpha=0.6)
    axes.plot(
        curve.forecast,
        curve.observed,
        color=colour,
        marker="o",
        markersize=1.2 if reference else 2.4,
        clip_on=False,
        **style.line(model, "low") | {"linewidth": 0.7 if reference else 1.1},
    )


def _histograms(axes: Axes, cells: list[Forecasts | None], colours: list[str]) -> None:
    """Plot a row of bars for each model, scaled to the highest bar of the row."""
    left = np.arange(BINS) / BINS
    for row, (forecasts, colour) in enumerate(zip(reversed(cells), reversed(colours), strict=True)):
        if forecasts is not None:
            group = group_of(forecasts.probability.ravel(), BINS, smallest=1)
            count = np.bincount(group, minlength=BINS)
            heights = 0.82 * count / count.max()
            axes.bar(left, heights, 0.86 / BINS, bottom=row, color=colour, align="edge")
        axes.axhline(row, color="#BBBBBB", linewidth=0.4)
    axes.set(ylim=(0, len(cells)), yticks=[])
    axes.grid(visible=False)
    axes.spines["left"].set_visible(False)


def _counts(cells: list[dict[str, Forecasts]]) -> str:
    """The largest number of scenarios, and the numbers of training seeds."""
    scenarios = max(len(f.observed) for cell in cells for f in cell.values())
    trained = [len(f.probability) for c in cells for model, f in c.items() if model != ORACLE]
    return (
        f"{scenarios} scenarios, {training_seeds(trained)};\nbars: 95 % t intervals over scenarios"
    )


def _legend(figure: Figure, shown: list[str], palette: dict[str, str], counts: str) -> None:
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=palette[m], label=label(m), **style.line(m, "low")) for m in shown
    ]
    handles += [
        Line2D([], [], color="black", linewidth=0.6, label="reliable"),
        Line2D([], [], color="black", linewidth=0.6, linestyle=":", label="base rate"),
        Patch(color=SHADE, label="better than base rate"),
    ]
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=style.columns(handles),
        handlelength=1.6,
        columnspacing=1.2,
        title=counts,
        title_fontsize=mpl.rcParams["legend.fontsize"],
    )


if __name__ == "__main__":
    sys.exit(command(plot, "Reliability diagrams of the goal."))
