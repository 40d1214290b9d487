"""Bands: the quantiles of forecast and observed states, dimension by dimension, over the horizon."""

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from study.recording.palette import FORECAST, OBSERVED, Colour, faint
from study.recording.streams import finite, send_scalars, style_lines, time_column

if TYPE_CHECKING:
    from study.envs.simulator import Variable

TIMELINE = "horizon"
LEVELS = (0.05, 0.25, 0.50, 0.75, 0.95)
NAMES = ("5 %", "25 %", "50 %", "75 %", "95 %")
_WIDTHS = (0.7, 0.7, 2.5, 0.7, 0.7)


def quantiles(states: NDArray[np.float32]) -> NDArray[np.float64]:
    """The quantiles 5, 25, 50, 75 and 95 % [5, T, D] of states [K, T, D].

    What is not finite is left out; where nothing is finite the quantile is NaN.
    """
    table = finite(states)
    lost = np.isnan(table).all(axis=0)
    bands = np.nanquantile(np.where(lost, 0.0, table), LEVELS, axis=0)
    return np.where(lost, np.nan, bands)


def log_bands(
    stream: rr.RecordingStream,
    entity: str,
    observed: NDArray[np.float64],
    forecast: NDArray[np.float64],
) -> None:
    """The bands [5, T] of one dimension: lines that can be read back, and shading behind them.

    `entity/observed` and `entity/forecast` hold five scalars a step, `entity/shade/…` what is
    needed to draw them: a line without width and a "standard deviation" of half the band.
    """
    times = np.arange(1, observed.shape[1] + 1)
    for name, bands, colour in (("observed", observed, OBSERVED), ("forecast", forecast, FORECAST)):
        names = [f"{name} {level}" for level in NAMES]
        colours = [faint(colour, 255 if level == "50 %" else 150) for level in NAMES]
        style_lines(stream, f"{entity}/{name}", names, colours, _WIDTHS)
        send_scalars(stream, f"{entity}/{name}", TIMELINE, times, bands.T)
        _log_shade(stream, f"{entity}/shade/{name}", times, bands, colour)


def axis_range(
    observed: NDArray[np.float64], forecast: NDArray[np.float64]
) -> tuple[float, float] | None:
    """A y axis for the bands [5, T]: it shows the observed ones and at most as much again.

    So a forecast that has diverged leaves the view instead of flattening what was observed.
    """
    if not np.isfinite(observed).any():
        return None
    low, high = float(np.nanmin(observed)), float(np.nanmax(observed))
    reach = max(high - low, 1e-3 * max(abs(low), abs(high)), 1e-6)
    if np.isfinite(forecast).any():
        low = min(low, max(float(np.nanmin(forecast)), low - reach))
        high = max(high, min(float(np.nanmax(forecast)), high + reach))
    margin = 0.05 * max(high - low, reach)
    return low - margin, high + margin


def title(variable: "Variable") -> str:
    """A variable's name and unit, as a plot's title."""
    return f"{variable.name} [{variable.unit}]" if variable.unit else variable.name


def _log_shade(
    stream: rr.RecordingStream,
    entity: str,
    times: NDArray[np.int64],
    bands: NDArray[np.float64],
    colour: Colour,
) -> None:
    outer, inner = bands[[0, 4]], bands[[1, 3]]
    middles = np.stack([outer.mean(axis=0), inner.mean(axis=0)], axis=1)
    halves = np.stack([outer[1] - outer[0], inner[1] - inner[0]], axis=1) / 2
    look = rr.Measurements.from_fields(
        colors=[colour] * 2, widths=[0.0] * 2, names=["5–95 %", "25–75 %"]
    )
    stream.log(entity, look, static=True)
    columns = rr.Measurements.columns(
        values=middles.astype(np.float32).reshape(-1),
        variances=(halves**2).astype(np.float32).reshape(-1),
    ).partition(np.full(len(times), 2))
    stream.send_columns(entity, [time_column(TIMELINE, times)], columns)
