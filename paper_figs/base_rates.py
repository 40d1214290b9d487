"""Histogram of the true probability of success of the test scenarios, for each environment.

    python -m paper_figs.base_rates results/paper

The true probability of a scenario is the share of its observed rollouts that reach the goal. The
dashed line is the base rate, the mean over scenarios.
"""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from paper_figs.command import command
from paper_figs.scores import environments, read_scores, rollouts
from study.common.arrays import Doubles
from study.config.names import label
from study.plotting import style

BINS = 10
MIDDLE, ENDS = "#56B4E9", "#BBBBBB"


def plot(results: Path) -> list[Path]:
    """Write figures/base_rates.png and .pdf into `results`.

    Raises:
        BadInput: there are no scores.
    """
    scores = read_scores(results)
    probabilities = scores[
        (scores["metric"] == "observed_probability")
        & (scores["dimension"] == "all")
        & (scores["scenario"] >= 0)
        & (scores["step"] == -1)
    ]
    # All cells of an environment are scored on the same rollouts.
    probabilities = probabilities.drop_duplicates(["environment", "scenario"])
    # A share of one rollout is no probability.
    repeated = [e for e in environments(probabilities) if rollouts(results, e) != 1]
    probabilities = probabilities[probabilities["environment"].isin(repeated)]
    if probabilities.empty:
        return []
    return _plot(probabilities, results / "figures" / "base_rates")


def _plot(probabilities: pd.DataFrame, stem: Path) -> list[Path]:
    names = environments(probabilities)
    with mpl.rc_context(style.context()):
        figure = style.figure(height=1.9)
        axes = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
        for panel, environment in zip(axes, names, strict=True):
            rows = probabilities[probabilities["environment"] == environment]
            probability = rows["value"].to_numpy(np.float64)
            _panel(panel, probability)
            shares = probability.round(6)  # stored in single precision
            uncertain = ((shares > 0.1) & (shares < 0.9)).mean()
            panel.set_title(
                f"{label(environment)}: base rate {probability.mean():.2f},\n"
                f"{100 * uncertain:.0f} % between 0.1 and 0.9",
                loc="left",
                fontsize=7,
            )
            panel.set_xlabel("true probability of success")
        axes[0].set_ylabel("number of scenarios")
        return style.save(figure, stem)


def _panel(axes: Axes, probability: Doubles) -> None:
    # Rounding must not move a probability at an edge, such as 0.3, to the bin below.
    bins = np.minimum(np.floor(probability * BINS + 1e-9).astype(int), BINS - 1)
    counts = np.bincount(bins, minlength=BINS)
    colours = [ENDS, *[MIDDLE] * (BINS - 2), ENDS]
    left = np.arange(BINS) / BINS
    axes.bar(left, counts, 1 / BINS, align="edge", color=colours, edgecolor="white", linewidth=0.5)
    base = probability.mean()
    axes.axvline(base, color="black", linewidth=0.9, linestyle=style.DASHES)
    axes.set_xlim(0, 1)


if __name__ == "__main__":
    sys.exit(command(plot, "Histogram of the true probability of success of the test scenarios."))
