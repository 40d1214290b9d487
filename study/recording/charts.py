"""Scatter and line charts in a 2D view of Rerun, since the x axis of Rerun's plots is always time.

A chart is a box of 1.6 × 1 units. The y axis points up.
"""

from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from matplotlib.ticker import LogLocator, MaxNLocator
from numpy.typing import ArrayLike

from study.common.arrays import Doubles, Floats
from study.plotting.palette import FRAME, faint

WIDTH = 1.6
# The part of the plane that a view shows: the box and room for its labels.
BOUNDS = rrb.VisualBounds2D(x_range=(-0.24, WIDTH + 0.08), y_range=(-1.17, 0.2))


@dataclass(frozen=True)
class Axis:
    """One axis of a chart.

    Attributes:
        label: the text of the axis.
        low: the value at the lower end.
        high: the value at the upper end.
        logarithmic: whether the scale is logarithmic.
    """

    label: str
    low: float
    high: float
    logarithmic: bool = False

    @classmethod
    def around(cls, label: str, values: ArrayLike, logarithmic: bool = False) -> "Axis":
        """An axis from the smallest to the largest finite value, with a margin."""
        numbers = np.asarray(values, dtype=np.float64)
        numbers = numbers[np.isfinite(numbers) & ((numbers > 0) | (not logarithmic))]
        if not numbers.size:
            return cls(label, 0.1, 1.0, logarithmic)
        low, high = float(numbers.min()), float(numbers.max())
        if logarithmic:
            margin = max(1.2, (high / low) ** 0.05)
            return cls(label, low / margin, high * margin, True)
        margin = 0.05 * (high - low) or 0.1 * abs(high) or 1.0
        return cls(label, low - margin, high + margin)

    def positions(self, values: ArrayLike) -> Doubles:
        """The positions of values [N] on the axis, from 0 at `low` to 1 at `high`."""
        numbers = np.asarray(values, dtype=np.float64)
        low, high = self.low, self.high
        if self.logarithmic:
            positive = np.where(numbers > 0, numbers, np.nan)
            numbers, low, high = np.log(positive), np.log(low), np.log(high)
        return np.asarray((numbers - low) / (high - low))

    def ticks(self) -> Doubles:
        """Round numbers between `low` and `high`."""
        if self.logarithmic:
            locator = LogLocator(base=10, subs=(1.0,), numticks=9)
            ticks = np.asarray(locator.tick_values(self.low, self.high))
            if np.sum((ticks >= self.low) & (ticks <= self.high)) < 2:
                locator = LogLocator(base=10, subs=(1.0, 2.0, 5.0), numticks=9)
                ticks = np.asarray(locator.tick_values(self.low, self.high))
        else:
            ticks = np.asarray(MaxNLocator(5).tick_values(self.low, self.high))
        slack = 1e-9 * abs(self.high - self.low)
        return np.asarray(ticks[(ticks >= self.low - slack) & (ticks <= self.high + slack)])


@dataclass(frozen=True)
class Chart:
    """A chart with an x and a y axis."""

    x: Axis
    y: Axis

    def points(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """Points [N, 2] of the view from x [N] and y [N], without those that are not finite."""
        points = np.column_stack([WIDTH * self.x.positions(x), -self.y.positions(y)])
        return points[np.isfinite(points).all(axis=1)].astype(np.float32)

    def log_axes(self, stream: rr.RecordingStream, entity: str) -> None:
        """Log the frame, the grid, the ticks and the labels."""
        frame = [[[0, 0], [WIDTH, 0], [WIDTH, -1], [0, -1], [0, 0]]]
        grid = [[[WIDTH * p, 0], [WIDTH * p, -1]] for p in self.x.positions(self.x.ticks())]
        grid += [[[0, -p], [WIDTH, -p]] for p in self.y.positions(self.y.ticks())]
        lines = rr.LineStrips2D(
            [np.array(strip, dtype=np.float32) for strip in [*frame, *grid]],
            colors=[FRAME] + [faint(FRAME, 60)] * len(grid),
            radii=rr.Radius.ui_points([1.0] + [0.5] * len(grid)),
        )
        stream.log(f"{entity}/frame", lines, static=True)
        marks = [([WIDTH * self.x.positions(t), 0.03], f"{t:g}") for t in self.x.ticks()]
        marks += [([-0.08, -self.y.positions(t) - 0.02], f"{t:g}") for t in self.y.ticks()]
        marks += [([WIDTH / 2, 0.11], self.x.label), ([0.06, -1.12], self.y.label)]
        labels = rr.Points2D(
            np.array([position for position, _ in marks], dtype=np.float32),
            labels=[text for _, text in marks],
            show_labels=True,
            colors=[FRAME],
            radii=rr.Radius.ui_points(0.0),
        )
        stream.log(f"{entity}/labels", labels, static=True)
