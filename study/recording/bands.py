"""Bands: the quantiles of forecast and observed states, dimension by dimension, over the horizon."""

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from study.recording.palette import FORECAST, OBSERVED, faint
from study.recording.streams import finite, time_column

if TYPE_CHECKING:
    from study.envs.simulator import Variable

TIMELINE = "horizon"
LEVELS = (0.05, 0.25, 0.50, 0.75, 0.95)
NAMES = [f"{source} {level:.0%}" for source in ("observed", "forecast") for level in LEVELS]
_WIDTHS = (0.7, 0.7, 2.5, 0.7, 0.7)
_ALPHAS = (150, 150, 255, 150, 150)


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
    """The bands [5, T] of one dimension: ten lines that can be read back, and shading behind them.

    All in one entity, and in one piece: a piece of a recording costs more than what is in it. The
    shade is a line without width at the middle of 5–95 %, its "standard deviation" half of it.
    """
    steps = observed.shape[1]
    lines = np.concatenate([observed, forecast]).T
    low, high = lines[:, [0, 5]], lines[:, [4, 9]]
    colours = [faint(c, a) for c in (OBSERVED, FORECAST) for a in _ALPHAS]
    style = rr.SeriesLines(names=NAMES, colors=colours, widths=_WIDTHS * 2)
    shade = rr.Measurements.from_fields(
        names=["observed 5–95 %", "forecast 5–95 %"], colors=[OBSERVED, FORECAST], widths=[0.0] * 2
    )
    stream.log(entity, style, shade, static=True)
    columns = [
        *rr.Scalars.columns(scalars=lines.reshape(-1)).partition(np.full(steps, 10)),
        *rr.Measurements.columns(
            values=((low + high) / 2).reshape(-1), variances=(((high - low) / 2) ** 2).reshape(-1)
        ).partition(np.full(steps, 2)),
    ]
    stream.send_columns(entity, [time_column(TIMELINE, np.arange(1, steps + 1))], columns)


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
