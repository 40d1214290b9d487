"""The residual VAE and the full VAE in every universe of a multiverse.

A panel for each environment has MMD² of the full VAE on the horizontal axis, and of the residual
VAE on the vertical axis, both logarithmic. Below the diagonal the residual VAE is better.
`paper_figs.specification_curve` writes the figure, beside the others of a multiverse.
"""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullLocator

from paper_figs.formatting import title
from study.config.names import FULL, RESIDUAL, label
from study.multiverse.design import RANDOM
from study.multiverse.folder import Multiverse
from study.plotting.png import WIDTH

COLOURS = ("#0072b2", "#d55e00", "#707070")
"""Of the universes around each base reading, and of those with random values."""
MARKS = ("o", "^", "s", "D")
"""Of the epistemic levels."""


def scores(multiverse: Multiverse) -> pd.DataFrame:
    """MMD² of both models, the mean over seeds.

    Returns:
        a row for each universe, environment and level in which both have a finite score, with the
        columns `FULL` and `RESIDUAL` and the `group` of the universe: its base reading or `RANDOM`.
    """
    groups = {universe.name: universe.group for universe in multiverse.universes}
    cells = multiverse.cells[multiverse.cells["model"].isin([FULL, RESIDUAL])]
    at = ["universe", "environment", "level"]
    means = cells.groupby([*at, "model"], sort=False)["mmd2"].mean().unstack("model")
    finite = means.reindex(columns=[FULL, RESIDUAL]).replace([np.inf, -np.inf], np.nan).dropna()
    rows = finite.reset_index()
    return rows.assign(group=rows["universe"].map(groups))


def draw(multiverse: Multiverse) -> Figure | None:
    """The figure; None if no universe has scores of both models."""
    rows = scores(multiverse)
    if rows.empty:
        return None
    names = (*multiverse.design.bases, RANDOM)
    groups = [name for name in names if name in set(rows["group"])]
    levels, environments = rows["level"].unique(), rows["environment"].unique()
    figure = Figure(figsize=(WIDTH, 2.9), layout="constrained")
    panels = figure.subplots(1, len(environments), squeeze=False)[0]
    colour = {name: COLOURS[names.index(name) % len(COLOURS)] for name in groups}
    mark = {name: MARKS[number % len(MARKS)] for number, name in enumerate(levels)}
    for axes, environment in zip(panels, environments, strict=True):
        here = rows[rows["environment"] == environment]
        for (group, level), part in here.groupby(["group", "level"]):
            axes.plot(
                part[FULL],
                part[RESIDUAL],
                mark[str(level)],
                color=colour[str(group)],
                markersize=3.2,
                alpha=0.75,
                markeredgewidth=0,
            )
        _axes(axes, here)
        axes.set_title(label(str(environment)), loc="left")
        axes.set_xlabel(f"MMD² of the {label(FULL)}")
    panels[0].set_ylabel(f"MMD² of the {label(RESIDUAL)}")
    handles = [
        Line2D([], [], color=colour[name], marker="o", linewidth=0, label=_in_words(name))
        for name in groups
    ]
    handles += [
        Line2D([], [], color="black", marker=mark[name], linewidth=0, label=label(name))
        for name in levels
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), markerscale=0.6)
    return figure


def _axes(axes: Axes, rows: pd.DataFrame) -> None:
    """Equal logarithmic axes, with the diagonal."""
    values = rows[[FULL, RESIDUAL]].to_numpy(np.float64)
    limits = values[values > 0].min(initial=1.0) / 1.3, values.max() * 1.3
    axes.plot(limits, limits, color="black", linewidth=0.6, zorder=0)
    axes.set(xscale="log", yscale="log", xlim=limits, ylim=limits, aspect="equal")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_locator(NullLocator())
    axes.text(
        0.97,
        0.03,
        f"{title(RESIDUAL)} better",
        transform=axes.transAxes,
        ha="right",
        fontsize=6,
    )
    axes.text(
        0.03,
        0.97,
        f"{title(FULL)} better",
        transform=axes.transAxes,
        va="top",
        fontsize=6,
    )


def _in_words(group: str) -> str:
    return group if group == RANDOM else f"around {label(group)}"
