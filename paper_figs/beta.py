"""What β costs: each trial's validation score against its β, for every search.

    python -m paper_figs.beta results/paper

A filled mark is a trial that ran to its end; an open one was pruned, and shows its last score. A
ring marks the β that was chosen.
"""

import sys
from pathlib import Path

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
    """Write figures/beta.png and .pdf into `results`, from its trials.parquet.

    Nothing is written if no model was tuned.

    Raises:
        BadInput: there is no table of trials.
    """
    path = results / "trials.parquet"
    if not path.is_file():
        raise BadInput(f"{results} holds no trials.parquet: run `python -m study.run all` first")
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
                here = (trials["environment"] == environment) & (trials["level"] == level)
                _panel(axis, trials[here], palette)
                axis.set_title(f"{label(environment)}, {label(level)}", loc="left")
            axes[0].set_ylabel("validation MMD²")
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
        # A trial that was pruned was scored earlier in its training: no line joins it.
        ended = search[search["state"] == "complete"]
        axes.plot(ended["beta"], ended["value"], color=colour, linewidth=0.7, alpha=0.5)
        for state, face in (("complete", colour), ("pruned", "white")):
            some = search[search["state"] == state]
            axes.plot(
                some["beta"], some["value"], "o", color=colour, markerfacecolor=face, markersize=3
            )
        chosen = search[search["chosen"]]
        axes.plot(
            chosen["beta"],
            chosen["value"],
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
    ring = {"color": "black", "markerfacecolor": "none", "linestyle": ""}
    return [
        *marks,
        Line2D([], [], marker="o", markersize=6.5, label="chosen", **ring),  # type: ignore[arg-type]
        Line2D([], [], marker="o", markersize=3, label="pruned", **ring),  # type: ignore[arg-type]
    ]


if __name__ == "__main__":
    sys.exit(command(plot, "Validation score against β, for every search."))
