"""Spread: the standard deviation of the position over the horizon, forecast in parts, observed."""

import numpy as np
import rerun as rr

from study.common.arrays import Doubles, Floats
from study.plotting.palette import ALEATORIC, EPISTEMIC, FORECAST, OBSERVED
from study.recording.streams import finite, send_scalars, style_lines

TIMELINE = "horizon"
NAMES = ("observed", "forecast: total", "forecast: aleatoric", "forecast: epistemic")
TITLE = "Spread of position [m]"


def log_spread(
    stream: rr.RecordingStream,
    entity: str,
    observed: Floats,
    aleatoric: Doubles,
    epistemic: Doubles,
) -> None:
    """Standard deviations in m: the roots of the variances that the parts [T] of a forecast are.

    Args:
        stream: the recording.
        entity: one entity holds the four lines, named as in `NAMES`.
        observed: [K, T, 3], observed positions.
        aleatoric: [T] m², summed over axes, as is `epistemic`. An estimate may by chance be below
            zero: its root is drawn as 0. What is not finite is left out.
        epistemic: [T] m².
    """
    with np.errstate(invalid="ignore", over="ignore"):
        seen = observed.var(axis=0, ddof=1, dtype=np.float64).sum(axis=-1)
        parts = finite(np.stack([seen, aleatoric + epistemic, aleatoric, epistemic], axis=-1))
        deviations = np.sqrt(np.maximum(parts, 0.0))
    colours = [OBSERVED, FORECAST, ALEATORIC, EPISTEMIC]
    style_lines(stream, entity, NAMES, colours, [3.0, 3.0, 2.0, 2.0])
    send_scalars(stream, entity, TIMELINE, np.arange(1, len(parts) + 1), deviations)
