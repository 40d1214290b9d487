"""Heat maps of MMD² by state dimension and forecast step, one figure for each environment.

    python -m paper_figs.mmd_by_dimension results/paper

One map for each model and level, with averages over scenarios and seeds. All maps of a figure share
one colour scale. It is a square root, so it is proportional to MMD. Negative values have the colour
of zero. The map of the oracle is the last one.
"""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import PowerNorm
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator

from paper_figs.command import command
from paper_figs.fig3_mmd import TICKS
from paper_figs.scores import environments, levels, models, read_scores
from study.config.names import ORACLE, label
from study.metrics.tables.table import select
from study.plotting import style

COLOURS = "viridis"
"""A colour map with perceptually uniform lightness."""

NAME_SIZE = 4.5
"""Font size of the names of dimensions."""
ROW = 0.066
"""Height of one dimension, in inches."""
LOWEST = 1.6
"""Height of a figure of few dimensions and models, in inches, so that its axes have room."""


def plot(results: Path) -> list[Path]:
    """Write figures/mmd_by_dimension_<environment>.png and .pdf into `results`.

    Raises:
        BadInput: there are no scores.
    """
    scores = read_scores(results)
    maps = scores[
        (scores["metric"] == "mmd2") & (scores["dimension"] != "all") & (scores["step"] > 0)
    ]
    written = []
    for environment in environments(maps):
        stem = results / "figures" / f"mmd_by_dimension_{environment}"
        part = maps[maps["environment"] == environment]
        written += _plot_environment(part, environment, stem)
    return written


def _plot_environment(scores: pd.DataFrame, environment: str, stem: Path) -> list[Path]:
    names = list(dict.fromkeys(scores["dimension"]))
    order = sorted(models(scores), key=lambda model: model == ORACLE)
    tables = {
        (model, level): table.mean().unstack("step").loc[names]
        for model in order
        for level in levels(scores)
        if not (
            table := select(scores, "mmd2", environment, level, model, by="dimension and step")
        ).empty
    }
    highest = max(float(np.nanmax(table.to_numpy())) for table in tables.values())
    norm = PowerNorm(0.5, 0, max(highest, float(TICKS[1])), clip=True)
    with mpl.rc_context(style.context()):
        height = 0.7 + len(order) * (0.19 + ROW * len(names))
        figure = style.figure(height=max(height, LOWEST))
        columns = len(levels(scores))
        panels = figure.subplots(len(order), columns, sharex=True, sharey=True, squeeze=False)
        for level, column in zip(levels(scores), panels.T, strict=True):
            for model, axes in zip(order, column, strict=True):
                if (model, level) in tables:
                    _map(axes, tables[model, level], norm)
                    axes.set_title(label(model), loc="left", size=6.5, pad=2)
                else:
                    axes.set_axis_off()
            column[0].set_title(f"{label(level)}\n{label(order[0])}", loc="left", size=6.5, pad=2)
            column[-1].set_xlabel("forecast step")
        panels[0, 0].xaxis.set_major_locator(MaxNLocator(4, integer=True))
        bar = figure.colorbar(
            ScalarMappable(norm, COLOURS), ax=panels, location="bottom", aspect=45, pad=0.01
        )
        bar.ax.xaxis.set_major_locator(FixedLocator(TICKS[norm.vmax >= TICKS].tolist()))
        bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        bar.set_label(f"{label(environment)}: MMD² (no unit; lower is better)")
        bar.outline.set_visible(False)
        # The PNG and the PDF have the same layout, since it takes longer than the plotting.
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        return style.save(figure, stem)


def _map(axes: Axes, table: pd.DataFrame, norm: PowerNorm) -> None:
    """Plot a table of dimensions × steps, the first dimension on top."""
    steps, count = table.columns.to_numpy(np.float64), len(table)
    axes.imshow(
        table.to_numpy(),
        norm=norm,
        cmap=COLOURS,
        aspect="auto",
        interpolation="nearest",
        extent=(steps[0] - 0.5, steps[-1] + 0.5, count - 0.5, -0.5),
    )
    axes.set_yticks(range(count), [str(name).replace("_", " ") for name in table.index])
    axes.tick_params(axis="y", labelsize=NAME_SIZE, length=0, pad=2)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)


if __name__ == "__main__":
    sys.exit(command(plot, "Heat maps of MMD² by state dimension and forecast step."))
