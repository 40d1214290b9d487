"""Reliability diagrams of the task's outcome, one figure for each environment.

    python -m paper_figs.reliability results/paper

A point is a group of scenarios that were given about the same probability of success, ten or more
of them for each seed: how often the task did succeed there, over what was forecast (see
`study.metrics.reliability`). Bars are 95 % intervals by a bootstrap over seeds and scenarios. On
the diagonal forecasts mean what they say; in the shaded area they beat the base rate, which is the
dotted line (the attributes diagram of Hsu and Murphy 1986). Below, how often each probability was
forecast: a forecaster that knows little stays near the base rate, one that is too sure at the ends.
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
from study.metrics.reliability import BINS, group_of, reliability_curve
from study.metrics.tables.table import select
from study.plotting import style

RESAMPLES = 1000
REFERENCES = (ENSEMBLE, ORACLE)
SHADE = "#EFEFE8"
STRIP = 0.12
"""Inches: the height of one histogram."""


@dataclass(frozen=True)
class Forecasts:
    """What one model forecast at one level, and what came of it."""

    probability: Doubles
    """[seeds, S]."""
    observed: Doubles
    """[S]."""


def plot(results: Path) -> list[Path]:
    """Write figures/reliability_<environment>.png and .pdf into `results`, from its scores alone.

    Raises:
        BadInput: there are no scores.
    """
    scores = read_scores(results)
    probabilities = scores[
        scores["metric"].isin(["forecast_probability", "observed_probability"])
        & (scores["scenario"] >= 0)
        & (scores["dimension"] == "all")
    ]
    written = []
    for environment in environments(probabilities):
        stem = results / "figures" / f"reliability_{environment}"
        own = probabilities[probabilities["environment"] == environment]
        written += _plot_environment(own, environment, stem)
    return written


def _plot_environment(scores: pd.DataFrame, environment: str, stem: Path) -> list[Path]:
    palette = style.colours(models(scores))
    with mpl.rc_context(style.context()):
        shown = levels(scores)
        cells = [_forecasts(scores, environment, level) for level in shown]
        named = [model for model in models(scores) if any(model in cell for cell in cells)]
        figure, panels, strips = _layout(len(shown), len(named))
        for level, cell, panel, strip in zip(shown, cells, panels, strips, strict=True):
            _background(panel, next(iter(cell.values())).observed.mean())
            for model, forecasts in cell.items():
                _curve(panel, forecasts, model, palette[model])
            _histograms(strip, [cell.get(model) for model in named], [palette[m] for m in named])
            panel.set_title(f"{label(environment)}, {label(level)}", loc="left")
        _legend(figure, named, palette, _counts(cells))
        return style.save(figure, stem)


def _forecasts(scores: pd.DataFrame, environment: str, level: str) -> dict[str, Forecasts]:
    """By model, those that have scores at this level."""
    found = {}
    for model in models(scores):
        probability, observed = (
            select(scores, f"{which}_probability", environment, level, model).to_numpy(np.float64)
            for which in ("forecast", "observed")
        )
        if probability.size:
            found[model] = Forecasts(probability, observed[0])
    return found


def _layout(columns: int, rows: int) -> tuple[Figure, list[Axes], list[Axes]]:
    """A panel a level, square if there are two, and under it a strip of histograms."""
    figure = style.figure(height=2.68 + STRIP * rows)
    axes = figure.subplots(
        2, columns, sharex=True, sharey="row", squeeze=False, height_ratios=[1.6, STRIP * rows]
    )
    for strip in axes[1]:
        strip.set_xlabel("forecast probability")
    axes[0, 0].set_ylabel("observed frequency")
    axes[1, 0].set_ylabel("forecasts")
    return figure, list(axes[0]), list(axes[1])


def _background(axes: Axes, base: float) -> None:
    """The diagonal, the base rate, and where forecasts are worth more than it."""
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
    curve = reliability_curve(forecasts.probability, forecasts.observed, resamples=RESAMPLES)
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
    """One row of bars a model, each scaled to its own highest."""
    left = np.arange(BINS) / BINS
    for row, (forecasts, colour) in enumerate(zip(reversed(cells), reversed(colours), strict=True)):
        if forecasts is not None:
            group = group_of(forecasts.probability.ravel(), BINS, least=1)
            count = np.bincount(group, minlength=BINS)
            heights = 0.82 * count / count.max()
            axes.bar(left, heights, 0.86 / BINS, bottom=row, color=colour, align="edge")
        axes.axhline(row, color="#BBBBBB", linewidth=0.4)
    axes.set(ylim=(0, len(cells)), yticks=[])
    axes.grid(visible=False)
    axes.spines["left"].set_visible(False)


def _counts(cells: list[dict[str, Forecasts]]) -> str:
    """How many scenarios and training seeds there are at most."""
    scenarios = max(len(each.observed) for cell in cells for each in cell.values())
    trained = [len(f.probability) for c in cells for model, f in c.items() if model != ORACLE]
    seeds = max(trained, default=0)
    return f"{scenarios} scenarios, {seeds} training seed{'' if seeds == 1 else 's'}"


def _legend(figure: Figure, shown: list[str], palette: dict[str, str], counts: str) -> None:
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=palette[m], label=label(m), **style.line(m, "low")) for m in shown
    ]
    handles += [
        Line2D([], [], color="black", linewidth=0.6, label="reliable"),
        Line2D([], [], color="black", linewidth=0.6, linestyle=":", label="base rate"),
        Patch(color=SHADE, label="beats base rate"),
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
    sys.exit(command(plot, "Reliability diagrams of the task's outcome, for each environment."))
