"""Bands: quantiles of observed and forecast states over the horizon, by dimension."""

import numpy as np
import rerun as rr

from study.common.arrays import Doubles, Floats
from study.data.variables import Variable
from study.plotting.palette import FORECAST, OBSERVED, faint
from study.recording.streams import finite, send_scalars, style_lines

TIMELINE = "horizon"
QUANTILES = (0.05, 0.25, 0.50, 0.75, 0.95)
NAMES = [f"{source} {share:.0%}" for source in ("observed", "forecast") for share in QUANTILES]
# Largest number of steps of a band. Bands are half of a forecast recording, and they are smooth.
_STEPS = 40
_WIDTHS = (0.8, 1.5, 3.0, 1.5, 0.8)
_OPACITIES = (150, 200, 255, 200, 150)


def quantiles(states: Floats) -> Doubles:
    """The quantiles `QUANTILES` [5, T, D] of states [K, T, D].

    Values that are not finite are ignored. Where no value is finite, the quantiles are NaN. So are
    those of no trajectories (K = 0).
    """
    if not len(states):
        return np.full((len(QUANTILES), *states.shape[1:]), np.nan)
    table = finite(states)
    undefined = np.isnan(table).all(axis=0)
    bands = np.nanquantile(np.where(undefined, 0.0, table), QUANTILES, axis=0)
    return np.where(undefined, np.nan, bands)


def log_bands(
    stream: rr.RecordingStream, entity: str, observed: Doubles, forecast: Doubles
) -> None:
    """Log the bands of one dimension as ten lines of one entity, named as in `NAMES`.

    All ten lines share one entity, since an entity takes more space than its numbers. Of a horizon
    longer than `_STEPS`, only every second (third, …) step is recorded, including the last one.

    Args:
        stream: the recording.
        entity: the entity.
        observed: [5, T], from `quantiles`.
        forecast: [5, T].
    """
    # The viewer can shade between the quantiles of `Measurements`. With two distributions in one
    # entity it shades around every line, and the forecast would look too uncertain.
    colours = [faint(colour, opacity) for colour in (OBSERVED, FORECAST) for opacity in _OPACITIES]
    style_lines(stream, entity, NAMES, colours, _WIDTHS * 2)
    horizon = observed.shape[1]
    stride = -(-horizon // _STEPS)
    steps = np.arange(horizon, 0, -stride)[::-1]
    values = np.concatenate([observed, forecast])[:, steps - 1].T
    send_scalars(stream, entity, TIMELINE, steps, values)


def axis_range(observed: Doubles, forecast: Doubles) -> tuple[float, float] | None:
    """The y axis of a plot of bands [5, T]: at most three times the observed range.

    So a forecast that has diverged does not flatten the observed bands. The result is None if the
    viewer's default axis shows the same, since an axis takes a kilobyte.
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


def title(variable: Variable) -> str:
    """The name and the unit of a variable, as the title of its plot."""
    return f"{variable.name} [{variable.unit}]" if variable.unit else variable.name
