"""Fig. 3 of the paper: MMD² over the forecast horizon, one figure for each environment.

    python -m paper_figs.fig3_mmd results/paper

Curves are averages over scenarios, state dimensions and seeds. Bands are 95 % t intervals over
seeds and scenarios at each step (`study.metrics.intervals`). The axis shows the range of the curves
and cuts wide bands. The vertical scale is a square root, so heights are proportional to MMD. The
unbiased MMD² of the oracle has mean zero and can be negative. Dotted lines are reference shifts:
the MMD² of the oracle's forecasts, shifted by 0.1, 0.3 and 1 standard deviations (sd) of the
observed rollouts.
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
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator

from paper_figs.command import command
from paper_figs.scores import environments, levels, models, read_scores
from study.common.arrays import Doubles
from study.config.names import ORACLE, label
from study.metrics.intervals import band, basis, training_seeds
from study.metrics.tables.scores import SHIFT_METRICS
from study.metrics.tables.table import select
from study.plotting import style

REFERENCE_SHIFTS = {metric: f"{shift:g} sd" for metric, shift in SHIFT_METRICS.items()}
"""The label of the line of each reference shift, by metric."""

SHIFT_LINE: dict[str, Any] = {"color": "#999999", "linewidth": 0.6, "linestyle": ":"}

TICKS = np.array([0, 0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0])


def plot(results: Path) -> list[Path]:
    """Write figures/mmd_<environment>.png and .pdf into `results`.

    Raises:
        BadInput: there are no scores.
    """
    scores = read_scores(results)
    curves = scores[(scores["metric"] == "mmd2") & (scores["scenario"] >= 0) & (scores["step"] > 0)]
    shifts = scores[scores["metric"].isin(REFERENCE_SHIFTS) & (scores["step"] > 0)]
    written = []
    for environment in environments(curves):
        stem = results / "figures" / f"mmd_{environment}"
        written += _plot_environment(
            curves[curves["environment"] == environment],
            shifts[shifts["environment"] == environment],
            environment,
            stem,
        )
    return written


def _plot_environment(
    curves: pd.DataFrame, shifts: pd.DataFrame, environment: str, stem: Path
) -> list[Path]:
    palette = style.colours(models(curves))
    counts = {}
    with mpl.rc_context(style.context()):
        # More models need a higher legend; the panel keeps its height.
        figure = style.figure(height=2.85 + 0.15 * max(0, len(models(curves)) - 7))
        axes = figure.subplots()
        for model in models(curves):
            for level in levels(curves):
                values = curve_values(curves, environment, level, model)
                if values is None or (model == ORACLE and ORACLE in counts):
                    continue
                counts[model] = values.shape[:2]
                _curve(axes, values, model, level, palette[model])
        _reference_shifts(axes, shifts)
        seeds = {r for model, (r, _) in counts.items() if model != ORACLE} or {1}
        _finish(axes, environment, max(s for _, s in counts.values()), seeds)
        _legend(figure, list(counts), levels(curves), palette, not shifts.empty, seeds)
        return style.save(figure, stem)


def curve_values(curves: pd.DataFrame, environment: str, level: str, model: str) -> Doubles | None:
    """MMD² [seeds, S, T]; None for a cell without scores."""
    table = select(curves, "mmd2", environment, level, model, by="step and scenario")
    if table.empty:
        return None
    by_step = table.sort_index(axis="columns").to_numpy(np.float64)
    steps = table.columns.get_level_values("step").nunique()
    return by_step.reshape(len(table), steps, -1).swapaxes(1, 2)


def _curve(axes: Axes, values: Doubles, model: str, level: str, colour: str) -> None:
    interval = band(values)
    steps = np.arange(1, values.shape[2] + 1)
    axes.fill_between(steps, interval.low, interval.high, color=colour, alpha=0.18, linewidth=0)
    axes.plot(steps, interval.estimate, color=colour, **style.line(model, level))


def _reference_shifts(axes: Axes, shifts: pd.DataFrame) -> None:
    for metric, name in REFERENCE_SHIFTS.items():
        line = shifts[shifts["metric"] == metric].groupby("step")["value"].mean()
        if len(line):
            axes.plot(line.index, line, zorder=1, **SHIFT_LINE)
            axes.annotate(
                name,
                (line.index[-1], line.iloc[-1]),
                (2, 0),
                textcoords="offset points",
                color="#666666",
                fontsize=5.5,
                va="center",
            )


def _finish(axes: Axes, environment: str, scenarios: int, seeds: set[int]) -> None:
    axes.set_yscale("function", functions=(_signed_root, _signed_square))
    curves = np.concatenate([np.asarray(line.get_ydata()) for line in axes.lines])
    # With few seeds a band can be far wider, and reach below zero, where no true MMD² is.
    top = 1.2 * float(curves.max())
    axes.set_ylim(min(1.5 * float(curves.min()), -0.001), top)
    axes.yaxis.set_major_locator(FixedLocator(TICKS[top >= TICKS].tolist()))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlim(left=0)
    axes.set_xlabel("forecast step")
    axes.set_ylabel("MMD² (no unit; lower is better)")
    counts = f"{scenarios} scenarios, {training_seeds(seeds)}"
    axes.set_title(f"{label(environment)} ({counts})", loc="left")


def _legend(
    figure: Figure,
    shown_models: list[str],
    shown_levels: list[str],
    palette: dict[str, str],
    with_shifts: bool,
    seeds: set[int],
) -> None:
    """A legend of colours for models, of line styles for levels, and of what bands are."""
    handles = [
        Line2D([], [], color=palette[model], label=label(model), **style.line(model, "low"))
        for model in shown_models
    ]
    handles += [
        Line2D([], [], color="black", label=label(level), **style.line("", level))
        for level in shown_levels
    ]
    if with_shifts:
        handles.append(Line2D([], [], label="reference shift", **SHIFT_LINE))
    ncols = style.columns(handles)
    legend = figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=ncols,
        handlelength=2.2,
        title=f"bands: {basis(seeds)}".replace("; ", ";\n"),
        title_fontsize=mpl.rcParams["legend.fontsize"],
    )
    legend.get_title().set_multialignment("center")


def _signed_root(value: Doubles) -> Doubles:
    return np.sign(value) * np.sqrt(np.abs(value))


def _signed_square(value: Doubles) -> Doubles:
    return np.sign(value) * np.square(value)


if __name__ == "__main__":
    sys.exit(command(plot, "MMD² over the forecast horizon: the paper's Fig. 3."))
