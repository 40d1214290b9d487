"""The values that a figure of the page shows on hover and tap."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from paper_figs.fig3_mmd import curve_values
from paper_figs.formatting import number
from paper_figs.reliability import forecasts_by_model, probabilities
from paper_figs.scores import environments, levels, models
from study.config.names import ORACLE, label
from study.metrics.intervals import band
from study.metrics.reliability import BINS, reliability_curve


@dataclass(frozen=True)
class Area:
    """A part of a panel, from top to bottom, with its text.

    Attributes:
        panel: the position of the panel in the figure.
        left: its left end, in units of the horizontal axis.
        right: its right end.
        text: what is shown.
    """

    panel: int
    left: float
    right: float
    text: str


Hover = Sequence[Area]
"""The areas of a figure."""


def hovers(scores: pd.DataFrame) -> Iterator[tuple[str, Hover]]:
    """The areas of each figure that has some, by the name of the figure."""
    yield from mmd_steps(scores)
    yield from reliability_bins(scores)


def mmd_steps(scores: pd.DataFrame) -> Iterator[tuple[str, Hover]]:
    """The values of the curves of each figure ``mmd_<environment>``, by step."""
    curves = scores[(scores["metric"] == "mmd2") & (scores["scenario"] >= 0) & (scores["step"] > 0)]
    for environment in environments(curves):
        part = curves[curves["environment"] == environment]
        lines: dict[int, list[str]] = {}
        for model in models(part):
            shown = levels(part)[:1] if model == ORACLE else levels(part)
            for level in shown:
                _add(lines, part, environment, level, model)
        yield (
            f"mmd_{environment}",
            [
                Area(
                    0,
                    step - 0.5,
                    step + 0.5,
                    "\n".join([f"{label(environment)}, step {step}: MMD²", *lines[step]]),
                )
                for step in lines
            ],
        )


def _add(
    lines: dict[int, list[str]], curves: pd.DataFrame, environment: str, level: str, model: str
) -> None:
    values = curve_values(curves, environment, level, model)
    if values is None:
        return
    found = band(values)
    name = label(model) if model == ORACLE else f"{label(model)}, {label(level)}"
    for index in range(values.shape[2]):
        estimate, low, high = (
            number(float(part[index])) for part in (found.estimate, found.low, found.high)
        )
        lines.setdefault(index + 1, []).append(f"{name}: {estimate} [{low}, {high}]")


def reliability_bins(scores: pd.DataFrame) -> Iterator[tuple[str, Hover]]:
    """The points of each figure ``reliability_<environment>``, by bin of forecast probability."""
    rows = probabilities(scores)
    for environment in environments(rows):
        part = rows[rows["environment"] == environment]
        areas = []
        for panel, level in enumerate(levels(part)):
            head = f"{label(environment)}, {label(level)}"
            areas += [
                Area(panel, place / BINS, (place + 1) / BINS, f"{head}, {text}")
                for place, text in _bins(part, environment, level).items()
            ]
        yield f"reliability_{environment}", areas


def _bins(rows: pd.DataFrame, environment: str, level: str) -> dict[int, str]:
    """The text of each bin with points."""
    lines: dict[int, list[str]] = {}
    for model, forecasts in forecasts_by_model(rows, environment, level).items():
        curve = reliability_curve(forecasts.probability, forecasts.observed)
        for values in zip(curve.forecast, curve.observed, curve.low, curve.high, strict=True):
            forecast, observed, low, high = (number(float(value), 2) for value in values)
            if np.isfinite(values[0]):
                place = min(int(values[0] * BINS), BINS - 1)
                lines.setdefault(place, []).append(
                    f"{label(model)}: forecast {forecast}, observed {observed} [{low}, {high}]"
                )
    return {
        place: "\n".join(
            [f"forecast probability {place / BINS:.1f} to {(place + 1) / BINS:.1f}", *lines[place]]
        )
        for place in sorted(lines)
    }
