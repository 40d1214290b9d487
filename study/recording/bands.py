"""Bands: quantiles of forecast and observed states, by dimension, over the horizon."""

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from study.common.arrays import Doubles, Floats
from study.plotting.palette import FORECAST, OBSERVED, faint
from study.recording.streams import finite, send_scalars, style_lines

if TYPE_CHECKING:
    from study.envs.simulator import Variable

TIMELINE = "horizon"
LEVELS = (0.05, 0.25, 0.50, 0.75, 0.95)
NAMES = [f"{source} {level:.0%}" for source in ("observed", "forecast") for level in LEVELS]
# Of a longer horizon every second step (or third …) is recorded, to the last: bands are smooth, and
# half of what a recording of forecasts takes.
_STEPS = 40
_WIDTHS = (0.8, 1.5, 3.0, 1.5, 0.8)
_ALPHAS = (150, 200, 255, 200, 150)


def quantiles(states: Floats) -> Doubles:
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
    observed: Doubles,
    forecast: Doubles,
) -> None:
    """The bands [5, T] of one dimension as ten lines: observed, then forecast.

    All in one entity: an entity, and each piece of it, costs more than what is in it. No
    `Measurements` beside them to shade the bands: on one entity with `Scalars`, the viewer shades
    around every line, and shows a forecast wider than it is.
    """
    colours = [faint(c, a) for c in (OBSERVED, FORECAST) for a in _ALPHAS]
    style_lines(stream, entity, NAMES, colours, _WIDTHS * 2)
    horizon = observed.shape[1]
    every = -(-horizon // _STEPS)
    steps = np.arange(horizon, 0, -every)[::-1]
    values = np.concatenate([observed, forecast])[:, steps - 1].T
    send_scalars(stream, entity, TIMELINE, steps, values)


def axis_range(observed: Doubles, forecast: Doubles) -> tuple[float, float] | None:
    """A y axis for the bands [5, T]: it shows the observed ones and at most as much again.

    So a forecast that has diverged leaves the view instead of flattening what was observed. None
    where the viewer's own choice, all that there is, shows the same: an axis takes a kilobyte.
    """
    if not np.isfinite(observed).any():
        return None
    low, high = float(np.nanmin(observed)), float(np.nanmax(observed))
    least = max(1e-3 * max(abs(low), abs(high)), 1e-6)
    reach = max(high - low, least)
    bottom, top = low - reach, high + reach
    if np.isfinite(forecast).any():
        low, high = min(low, float(np.nanmin(forecast))), max(high, float(np.nanmax(forecast)))
    if bottom <= low and high <= top and high - low >= least:
        return None
    low, high = max(low, bottom), min(high, top)
    margin = 0.05 * max(high - low, reach)
    return low - margin, high + margin


def title(variable: "Variable") -> str:
    """A variable's name and unit, as a plot's title."""
    return f"{variable.name} [{variable.unit}]" if variable.unit else variable.name
