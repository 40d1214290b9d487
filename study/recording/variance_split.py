"""The standard deviation of the position over the horizon: observed, and forecast in two parts."""

import numpy as np
import rerun as rr

from study.common.arrays import Doubles, Floats
from study.plotting.palette import ALEATORIC, EPISTEMIC, FORECAST, OBSERVED
from study.recording.streams import finite, send_scalars, style_lines

TIMELINE = "horizon"
NAMES = ("observed", "forecast: total", "forecast: aleatoric", "forecast: epistemic")
TITLE = "Standard deviation of the position [m]"


def log_variance_split(
    stream: rr.RecordingStream,
    entity: str,
    observed: Floats,
    aleatoric: Doubles,
    epistemic: Doubles,
) -> None:
    """Log four standard deviations in m, the roots of the variances, as lines of one entity.

    The lines are named as in `NAMES`. An unbiased estimate of a variance can be below zero by
    chance: its root is shown as 0. Values that are not finite are left out.

    Args:
        stream: the recording.
        entity: the entity.
        observed: [K, T, 3], observed positions in m.
        aleatoric: [T], aleatoric variance of the forecast in m², summed over axes.
        epistemic: [T], epistemic variance of the forecast in m², summed over axes.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        true = observed.var(axis=0, ddof=1, dtype=np.float64).sum(axis=-1)
        variances = finite(np.stack([true, aleatoric + epistemic, aleatoric, epistemic], axis=-1))
        deviations = np.sqrt(np.maximum(variances, 0.0))
    colours = [OBSERVED, FORECAST, ALEATORIC, EPISTEMIC]
    style_lines(stream, entity, NAMES, colours, [3.0, 3.0, 2.0, 2.0])
    send_scalars(stream, entity, TIMELINE, np.arange(1, len(deviations) + 1), deviations)
