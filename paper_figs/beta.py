"""Validation score of each trial of the searches for β, over β.

    python -m paper_figs.beta results/paper

A filled marker is a complete trial. An open marker is a pruned trial, at its last score. A ring
marks the chosen β.
"""

import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from paper_figs.command import command
from paper_figs.scores import environments, levels, models
from study.common.errors import BadInput
from study.config.names import label
from study.plotting import style


def plot(results: Path) -> list[Path]:
    """Write figures/beta.png and .pdf into `results`; nothing if no β was tuned.

    Raises:
        BadInput: there is no trials.parquet.
    """
    path = results / "trials.parquet"
    if not path.is_file():
        raise BadInput(f"{results} has no trials.parquet: run `python -m study.run all` first")
    trials = pd.read_parquet(path)
    return _plot(trials, results / "figures" / "beta") if len(trials) else []


def _plot(trials: pd.DataFrame, stem: Path) -> list[Path]:
    palette = style.colours(models(trials))
    columns, rows = environments(trials), levels(trials)
    with mpl.rc_context(style.context()):
        figure = style.figure(height=1.25 * len(rows) + 0.75)
        grid = figure.subplots(len(rows), len(columns), squeeze=False, sharex=True)
        for axes, level in zip(grid, rows, strict=True):
            for axis, environment in zip(axes, columns, strict=True):
                in_panel = (trials["environment"] == environment) & (trials["level"] == level)
                _panel(axis, trials[in_panel], palette)
                axis.set_title(f"{label(environment)}, {label(level)}", loc="left")
            axes[0].set_ylabel("validation score")
        for axis in grid[-1]:
            axis.set_xlabel("β")
        figure.legend(
            handles=_legend(trials, palette), loc="outside lower center", ncols=3, handlelength=1.2
        )
        return style.save(figure, stem)


def _panel(axes: Axes, trials: pd.DataFrame, palette: dict[str, str]) -> None:
    axes.set_xscale("log")
    for (model, _), search in trials.groupby(["model", "seed"]):
        colour = palette[str(model)]
        search = search.sort_values("beta")
        # The score of a pruned trial is from an earlier step, so the line leaves the trial out.
        complete = search[search["state"] == "complete"]
        axes.plot(complete["beta"], complete["value"], color=colour, linewidth=0.7, alpha=0.5)
        for state, face in (("complete", colour), ("pruned", "white")):
            trial = search[search["state"] == state]
            axes.plot(
                trial["beta"], trial["value"], "o", color=colour, markerfacecolor=face, markersize=3
            )
        best = search[search["chosen"]]
        axes.plot(
            best["beta"],
            best["value"],
            "o",
            color="black",
            markerfacecolor="none",
            markersize=6.5,
            markeredgewidth=0.8,
        )


def _legend(trials: pd.DataFrame, palette: dict[str, str]) -> list[Line2D]:
    marks = [
        Line2D([], [], color=palette[model], marker="o", markersize=3, label=label(model))
        for model in models(trials)
    ]
    hollow: dict[str, Any] = {"color": "black", "markerfacecolor": "none", "linestyle": ""}
    ring = Line2D([], [], marker="o", markersize=6.5, label="chosen β", **hollow)
    circle = Line2D([], [], marker="o", markersize=3, label="pruned trial", **hollow)
    return [*marks, ring, circle]


if __name__ == "__main__":
    sys.exit(command(plot, "Validation score of each trial of the searches for β, over β."))
