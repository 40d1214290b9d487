"""Specification curves of a multiverse: the effect of a claim in every universe.

    python -m paper_figs.specification_curve results/multiverse

One figure for each claim (Simonsohn, Simmons and Nelson 2020). Above, the decisive effect of each
universe with its 95 % interval, in ascending order, in the colour of the verdict on the claim, and
the effects of its other contrasts in grey. The scale is linear up to the smallest effect of
interest and logarithmic beyond, so that a universe in which a model diverges hides no other.
Below, a dot for the value that the universe has of each choice. Vertical lines mark the base
readings. A further figure, ``verdicts``, shows the share of each verdict for every claim, and one
more, ``vae_scores``, the scores of the two VAEs: see `paper_figs.vae_scores`.
"""

import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from paper_figs import vae_scores
from paper_figs.command import command
from study.claims.claim import Claim, Rule
from study.claims.judge import CLAIMS, Outcome
from study.common.arrays import Doubles
from study.common.errors import BadInput
from study.config.names import label
from study.multiverse.design import Choice
from study.multiverse.effects import curve, judged, shares
from study.multiverse.folder import FACTS, Multiverse, read
from study.plotting import style
from study.plotting.palette import VERDICTS as PALETTE
from study.plotting.png import WIDTH

COLOURS = {verdict: style.hexadecimal(colour) for verdict, colour in PALETTE.items()}
ROW = 0.115
"""Height of a row of the grid, in inches."""
CURVE = 1.7
"""Height of the curve, in inches."""
TITLE = 95
"""Length of a line of the title, in characters."""
OTHER = "#B0B0B0"
"""The colour of effects of contrasts that are not decisive."""
SMALLEST: dict[str, Any] = {"color": "black", "linewidth": 0.6, "linestyle": (0, (1, 2))}
"""The line of the smallest effect of interest, or of the margin of a claim of equivalence."""
EMPTY = "#ECECEC"
"""The colour of the dots of values that a universe does not have."""
MISSING = f"nothing to write: no {FACTS}; the folder is that of a study and not of a multiverse"


def plot(results: Path) -> list[Path]:
    """Write figures/specification_<claim>.png, verdicts.png and vae_scores.png; all as curves.pdf.

    A folder without a multiverse gets no figure.

    Raises:
        BadInput: there is no such folder.
    """
    if not results.is_dir():
        raise BadInput(f"there is no folder {results}: run `python -m study.run multiverse` first")
    if not (results / FACTS).is_file():
        return []
    multiverse = read(results)
    names = judged(multiverse.effects)
    claims = [claim for claim in CLAIMS if claim.id in names]
    if not claims:
        return []
    pdf = results / "figures" / "curves.pdf"
    written = []
    with mpl.rc_context(style.context()), style.one_pdf(pdf):
        written += style.save(_verdicts(multiverse, claims), results / "figures" / "verdicts")
        if (drawing := vae_scores.draw(multiverse)) is not None:
            written += style.save(drawing, results / "figures" / "vae_scores")
        for claim in claims:
            stem = results / "figures" / f"specification_{claim.id}"
            written += style.save(_specification(multiverse, claim), stem)
    return [*written, *([pdf] if pdf.is_file() else [])]


def _specification(multiverse: Multiverse, claim: Claim) -> Figure:
    rows = curve(multiverse.effects, claim.id)
    choices = multiverse.design.choices
    lines = sum(len(choice.values) for choice in choices) + 0.6 * len(choices)
    figure = Figure(figsize=(WIDTH, CURVE + 0.75 + ROW * lines), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[CURVE, ROW * lines])
    others = _other_contrasts(rows, multiverse.effects, claim)
    _plot_curve(above, rows, others, claim)
    _plot_grid(below, rows, multiverse)
    _mark_bases(above, below, rows, multiverse)
    above.set_title("\n".join(textwrap.wrap(claim.text, TITLE)), loc="left")
    above.set_xlim(-1, len(rows))
    below.set_xlabel(f"{len(rows)} universes, in the order of the effect")
    found = shares(multiverse.effects, claim.id)
    handles = _legend(rows, claim, found, has_other_contrasts=len(others) > 0)
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def _legend(
    rows: pd.DataFrame, claim: Claim, found: dict[Outcome, float], *, has_other_contrasts: bool
) -> list[Line2D]:
    """The verdicts with their counts and shares, and the other marks of the curve."""
    counts = rows["verdict"].value_counts()
    marks: dict[str, dict[str, Any]] = {
        f"{verdict}: {counts.get(verdict, 0)} ({share:.0%})": {
            "color": COLOURS[verdict],
            "marker": "o",
            "markersize": 3,
        }
        for verdict, share in found.items()
    }
    is_equivalence = claim.rule is Rule.EQUAL
    marks["margin" if is_equivalence else "smallest effect of interest"] = SMALLEST
    if has_other_contrasts:
        marks["other contrasts"] = {
            "color": OTHER,
            "marker": "o",
            "markersize": 1.4,
            "linewidth": 0,
        }
    return [Line2D([], [], label=label, **mark) for label, mark in marks.items()]


def _other_contrasts(rows: pd.DataFrame, effects: pd.DataFrame, claim: Claim) -> pd.DataFrame:
    """The effects of the contrasts that are not decisive, with the position of the universe."""
    others = effects[(effects["claim"] == claim.id) & ~effects["decisive"]]
    positions = dict(zip(rows["universe"], rows.index, strict=True))
    return others.assign(position=others["universe"].map(positions)).dropna(subset=["position"])


def _plot_curve(axes: Axes, rows: pd.DataFrame, others: pd.DataFrame, claim: Claim) -> None:
    """The decisive effects with their intervals, and the other effects without."""
    axes.axhline(0, color="black", linewidth=0.6)
    # The inverse hyperbolic sine: linear near 0, logarithmic far from it.
    axes.set_yscale("asinh", linear_width=claim.smallest_effect)
    for threshold in _thresholds(rows, claim):
        axes.plot(rows.index, threshold, **SMALLEST)
    low, high = _limits(rows, others, claim.smallest_effect)
    axes.plot(others["position"], others["effect"], "o", color=OTHER, markersize=1.4, zorder=1)
    for verdict, part in rows.groupby("verdict"):
        ends = part[["low", "high"]].clip(low - 1, high + 1)
        colour = COLOURS[str(verdict)]
        axes.vlines(part.index, ends["low"], ends["high"], color=colour, linewidth=0.9, alpha=0.6)
        axes.plot(part.index, part["effect"], "o", color=colour, markersize=2.6)
    axes.set_ylim(low, high)
    axes.set_yticks(_ticks(low, high, claim.smallest_effect), minor=False)
    axes.set_yticks([], minor=True)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_ylabel("effect of the decisive\ncontrast (asinh scale)")
    axes.grid(axis="x", visible=False)
    axes.tick_params(axis="x", length=0, labelbottom=False)


def _ticks(low: float, high: float, linear: float) -> list[float]:
    """0, and the powers of ten beyond the linear part; both ends of that part if there are none.

    Args:
        low: lower limit of the axis, in units of the effect.
        high: upper limit.
        linear: the effect up to which the scale is about linear.
    """
    first = int(np.ceil(np.log10(2 * linear)))
    powers = [10.0**power for power in range(first, 8)]
    found = [x for y in powers for x in (-y, y) if low <= x <= high]
    return [0.0, *(found or [-linear, linear])]


def _thresholds(rows: pd.DataFrame, claim: Claim) -> list[Doubles]:
    """What the effect of each universe is compared with: see `study.claims.claim.Rule`."""
    if claim.rule is Rule.EQUAL:
        margin = rows["margin"].to_numpy(np.float64)
        return [margin, -margin]
    sign = -1.0 if claim.rule is Rule.NOT_BELOW else 1.0
    return [np.full(len(rows), sign * claim.smallest_effect)]


def _limits(rows: pd.DataFrame, others: pd.DataFrame, linear: float) -> tuple[float, float]:
    """Limits that show all finite effects, and most of the intervals.

    Args:
        rows: the curve.
        others: the effects of the other contrasts.
        linear: the effect up to which the scale is about linear.
    """
    effects = np.arcsinh(np.concatenate([rows["effect"], others["effect"]]) / linear)
    effects = effects[np.isfinite(effects)]
    ends = np.arcsinh(rows[["low", "high"]].to_numpy() / linear)
    ends = ends[np.isfinite(ends)]
    low, high = float(effects.min(initial=0.0)), float(effects.max(initial=0.0))
    reach = max(high - low, 1e-6)
    low = max(low - reach, float(ends.min(initial=low)))
    high = min(high + reach, float(ends.max(initial=high)))
    return (
        linear * float(np.sinh(low - 0.06 * reach)),
        linear * float(np.sinh(high + 0.12 * reach)),
    )


def _plot_grid(axes: Axes, rows: pd.DataFrame, multiverse: Multiverse) -> None:
    """A row of dots for each value of each choice."""
    values = multiverse.values
    ticks, labels, row = [], [], 0.0
    for choice in multiverse.design.choices:
        first = row
        for value in choice.values:
            axes.plot(rows.index, np.full(len(rows), row), "o", color=EMPTY, markersize=1.6)
            for verdict, part in rows.groupby("verdict"):
                chosen = [values[name][choice.name] == value for name in part["universe"]]
                dots = part.index[chosen]
                axes.plot(dots, [row] * len(dots), "o", color=COLOURS[str(verdict)], markersize=2.6)
            ticks.append(row)
            labels.append(value)
            row += 1
        _name_choice(axes, choice, (first + row - 1) / 2)
        row += 0.6
    axes.set_yticks(ticks, labels, fontsize=5.5)
    axes.set_ylim(row - 0.4, -0.9)
    axes.grid(visible=False)
    axes.tick_params(length=0, labelbottom=False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _name_choice(axes: Axes, choice: Choice, row: float) -> None:
    """The name of a choice, to the right of its rows."""
    axes.text(
        1.005,
        row,
        label(choice.name),
        transform=axes.get_yaxis_transform(),
        va="center",
        fontsize=6,
        fontweight="bold",
    )


def _mark_bases(above: Axes, below: Axes, rows: pd.DataFrame, multiverse: Multiverse) -> None:
    for base in multiverse.design.bases:
        for position in rows.index[rows["universe"] == base]:
            for axes in (above, below):
                axes.axvline(position, color="black", linewidth=0.5, alpha=0.5, zorder=0)
            above.annotate(
                label(base),
                (position, 1.0),
                xycoords=above.get_xaxis_transform(),
                xytext=(2, -1),
                textcoords="offset points",
                va="top",
                fontsize=6,
                rotation=90,
            )


def _verdicts(multiverse: Multiverse, claims: Sequence[Claim]) -> Figure:
    """Stacked bars: the share of universes with each verdict, for every claim."""
    figure = Figure(figsize=(WIDTH, 0.7 + 0.17 * len(claims)), layout="constrained")
    axes = figure.subplots()
    for row, claim in enumerate(claims):
        left = 0.0
        found = shares(multiverse.effects, claim.id)
        for verdict, share in ((Outcome(name), found[Outcome(name)]) for name in PALETTE):
            axes.barh(row, share, left=left, color=COLOURS[verdict], height=0.75)
            if share >= 0.07:
                axes.text(left + share / 2, row, f"{share:.0%}", ha="center", va="center", size=5.5)
            left += share
    axes.set_yticks(range(len(claims)), [claim.id for claim in claims])
    axes.set_ylim(len(claims) - 0.4, -0.6)
    axes.set_xlim(0, 1)
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
    axes.set_xlabel("share of universes")
    axes.grid(visible=False)
    handles = [Patch(color=colour, label=name) for name, colour in COLOURS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


if __name__ == "__main__":
    sys.exit(command(plot, "Specification curves of a multiverse.", missing=MISSING))
