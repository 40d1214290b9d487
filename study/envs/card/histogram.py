"""The histogram of the scenarios' true probabilities of success."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from study.common.arrays import Booleans, Integers
from study.plotting import style
from study.plotting.png import save

BINS = 10
_SHADED = "#56B4E9"
_PLAIN = "#BBBBBB"


def counts(success: Booleans) -> Integers:
    """Number of scenarios in each bin of width 0.1.

    A probability on the edge of two bins belongs to the one further from 0.5. So the eight bins in
    the middle hold the probabilities strictly between 0.1 and 0.9.

    Args:
        success: [S, K], of K rollouts of each of S scenarios.

    Returns:
        [10]
    """
    rollouts = success.shape[1]
    # Integer arithmetic, in which 3 of 10 is exactly 0.3.
    tenths = success.sum(axis=1) * BINS
    below = np.maximum(-(-tenths // rollouts) - 1, 0)
    above = np.minimum(tenths // rollouts, BINS - 1)
    chosen = np.where(2 * tenths < BINS * rollouts, below, above)
    return np.bincount(chosen, minlength=BINS)


def uncertain(success: Booleans) -> float:
    """Share of the scenarios with a probability of success strictly between 0.1 and 0.9.

    Args:
        success: [S, K], of K rollouts of each of S scenarios.
    """
    scenarios, rollouts = success.shape
    tenths = success.sum(axis=1) * BINS
    return float(((tenths > rollouts) & (tenths < (BINS - 1) * rollouts)).sum()) / scenarios


def plot_histogram(success: Booleans, path: Path) -> Path:
    """Plot the histogram of the probabilities of success [S, K] to a PNG file."""
    scenarios, rollouts = success.shape
    base = float(success.mean())
    with mpl.rc_context(style.context()):
        figure = Figure(figsize=(style.COLUMN_WIDTH, 2.3), layout="constrained")
        axis = figure.subplots()
        left = np.arange(BINS) / BINS
        colours = [_PLAIN] + [_SHADED] * (BINS - 2) + [_PLAIN]
        axis.bar(left, counts(success), 1 / BINS, align="edge", color=colours, edgecolor="white")
        axis.axvspan(0.1, 0.9, color=_SHADED, alpha=0.12, linewidth=0)
        axis.axvline(base, color="black", linewidth=1.0, linestyle=style.DASHES)
        axis.annotate(
            f"base rate {base:.2f}",
            (base, 1.0),
            (3 if base < 0.7 else -3, -2),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            va="top",
            ha="left" if base < 0.7 else "right",
            fontsize=6.5,
        )
        axis.set(xlim=(0, 1), xticks=np.linspace(0, 1, 6))
        axis.set_ylim(0, 1.18 * max(int(counts(success).max()), 1))
        axis.set_xlabel("true probability of success")
        axis.set_ylabel("scenarios")
        axis.set_axisbelow(True)
        axis.set_title(
            f"{scenarios} scenarios × {rollouts} rollouts; "
            f"{uncertain(success):.0%} between 0.1 and 0.9",
            fontsize=7,
        )
        return save(figure, path, dpi=300)
