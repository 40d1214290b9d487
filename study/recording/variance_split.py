"""The standard deviation of the position over the horizon: observed, and forecast in two parts."""

import numpy as np
import rerun as rr

from study.common.arrays import Doubles, Floats
from study.plotting.palette import ALEATORIC, EPISTEMIC, FORECAST, OBSERVED
from study.recording.streams import finite, send_scalars, style_lines

TIMELINE = "horizon"
NAMES = ("observed", "forecast: total", "forecast: aleatoric", "forecast: epistemic")
TITLE = "Standard deviation of the position"


def log_variance_split(
    stream: rr.RecordingStream,
    entity: str,
    observed: Floats,
    aleatoric: Doubles,
    epistemic: Doubles,
) -> None:
    """Log four standard deviations in m, the roots of the variances, as lines of one entity.

    `NAMES` has the names of the lines. An unbiased estimate of a variance can be negative by
    chance; its root is then 0. Values that are not finite become NaN.

    Args:
        stream: the recording.
        entity: the entity.
        observed: [K, T, 3], observed positions in m.
        aleatoric: [T], aleatoric variance of the forecast in m², summed over axes.
        epistemic: [T], epistemic variance of the forecast in m², summed over axes.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        variance = np.full(len(aleatoric), np.nan)  # unknown without repeated rollouts
        if len(observed) > 1:
            variance = observed.var(axis=0, ddof=1, dtype=np.float64).sum(axis=-1)
        parts = (variance, aleatoric + epistemic, aleatoric, epistemic)
        stds = np.sqrt(np.maximum(finite(np.stack(parts, axis=-1)), 0.0))
    colours = [OBSERVED, FORECAST, ALEATORIC, EPISTEMIC]
    style_lines(stream, entity, NAMES, colours, [3.0, 3.0, 2.0, 2.0])
    send_scalars(stream, entity, TIMELINE, np.arange(1, len(stds) + 1), stds)
