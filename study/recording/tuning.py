"""The recording of a search for β: which values were tried, and what came of each."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from study.common.trials import score
from study.plotting.palette import FORECAST, STATE, TARGET, faint
from study.recording import blueprints
from study.recording.charts import Axis, Chart
from study.recording.properties import Properties, table, write_readme
from study.recording.streams import finite, recording, send_scalars

KIND = "tuning"
TIMELINE = "trial"
_README = """
# Tuning β

β weighs the KL term of the loss (equation 12). Each trial trains with one β and is scored by
free-running forecasts of *validation* trajectories, never of test ones. Lower is better.

**Green** a complete trial, **orange** one that was pruned because its intermediate
scores were worse than the others', **red** one that failed. The large dot is the best.

Below, the search as it went, trial by trial; the charts above are of the whole search.
"""


def record_tuning(path: Path, trials: Sequence[dict[str, Any]], properties: Properties) -> None:
    """Write the recording of a search.

    Args:
        path: the recording.
        trials: for each trial `number` (int), `beta` (float), `value` (float, or None if it has
            none), `state` ("complete", "pruned" or "failed") and `intermediate` ({step: value}).
        properties: of the recording.
    """
    ordered = sorted(trials, key=lambda trial: int(trial["number"]))
    numbers = np.array([trial["number"] for trial in ordered], dtype=np.int64)
    betas = np.array([trial["beta"] for trial in ordered], dtype=np.float64)
    values = finite(np.array([score(trial) for trial in ordered], dtype=np.float64))
    complete = np.array([trial["state"] == "complete" for trial in ordered], dtype=bool)
    best = best_so_far(np.where(complete, values, np.nan))

    # Small entities: an index of them would be larger than what it points to.
    with recording(path, KIND, properties, blueprints.tuning(), footer=False) as stream:
        write_readme(stream, _README + _table(ordered, best), properties)
        if not ordered:
            return
        for entity, series in (("/beta", betas), ("/log10_beta", np.log10(betas)), ("/best", best)):
            send_scalars(stream, entity, TIMELINE, numbers, series)
        steps = rr.components.InterpolationMode.StepAfter
        curve = rr.SeriesLines(
            names="best so far", colors=TARGET, widths=2.5, interpolation_mode=steps
        )
        stream.log("/best", curve, static=True)
        look = rr.SeriesPoints(colors=FORECAST, names="log₁₀ β", marker_sizes=5.0)
        stream.log("/log10_beta", look, static=True)
        for state, colour in STATE.items():
            chosen = np.array([trial["state"] == state for trial in ordered], dtype=bool)
            if chosen.any():
                send_scalars(stream, f"/value/{state}", TIMELINE, numbers[chosen], values[chosen])
                look = rr.SeriesPoints(colors=colour, names=state, marker_sizes=5.0)
                stream.log(f"/value/{state}", look, static=True)
        _chart_of_beta(stream, ordered, betas, values, best)
        _chart_of_intermediate(stream, ordered, betas)


def best_so_far(values: np.ndarray) -> np.ndarray:
    """The least of values [N] up to each of them, NaN until the first that is not NaN."""
    return np.fmin.accumulate(values)


def _best_index(best: np.ndarray) -> int | None:
    if not np.isfinite(best).any():
        return None
    return int(np.flatnonzero(best == np.nanmin(best))[0])


def _told(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"


def _table(trials: Sequence[dict[str, Any]], best: np.ndarray) -> str:
    winner = _best_index(best)
    headline = (
        "No trial is complete."
        if winner is None
        else f"**Best: β = {trials[winner]['beta']:.4g}**, score {best[winner]:.4g} "
        f"(trial {trials[winner]['number']} of {len(trials)})."
    )
    rows = [
        (str(trial["number"]), f"{trial['beta']:.4g}", _told(score(trial)), str(trial["state"]))
        for trial in trials
    ]
    return f"\n{headline}\n\n{table(('trial', 'β', 'score', 'state'), rows)}\n"


def _chart_of_beta(
    stream: rr.RecordingStream,
    trials: Sequence[dict[str, Any]],
    betas: np.ndarray,
    values: np.ndarray,
    best: np.ndarray,
) -> None:
    """Every trial as a dot; for all time, since a recording opens at its beginning."""
    chart = Chart(Axis.around("β", betas, logarithmic=True), Axis.around("score", values))
    chart.draw(stream, "/chart/beta")
    winner = _best_index(best)
    for index, trial in enumerate(trials):
        point = chart.place(betas[index : index + 1], values[index : index + 1])
        if not len(point):
            continue
        dot = rr.Points2D(
            point,
            colors=[STATE[trial["state"]]],
            radii=rr.Radius.ui_points(8.0 if index == winner else 4.5),
        )
        stream.log(f"/chart/beta/trial_{trial['number']}", dot, static=True)


def _chart_of_intermediate(
    stream: rr.RecordingStream, trials: Sequence[dict[str, Any]], betas: np.ndarray
) -> None:
    """The curve of every trial; its numbers too, as scalars on the timeline `step`."""
    sorted_steps = [sorted(trial["intermediate"].items()) for trial in trials]
    curves = [
        (np.array([step for step, _ in pairs]), np.array([value for _, value in pairs]))
        for pairs in sorted_steps
    ]
    everything = np.concatenate([values for _, values in curves] or [np.empty(0)])
    steps = np.concatenate([steps for steps, _ in curves] or [np.empty(0)])
    chart = Chart(Axis.around("step", steps), Axis.around("score", everything))
    chart.draw(stream, "/chart/intermediate")
    for trial, (steps, values) in zip(trials, curves, strict=True):
        if not len(steps):
            continue
        name = f"trial_{trial['number']}"
        send_scalars(stream, f"/intermediate/{name}", "step", steps, finite(values))
        strip = rr.LineStrips2D(
            [chart.place(steps, values)],
            colors=[faint(STATE[trial["state"]], 200)],
            radii=rr.Radius.ui_points(1.5),
        )
        stream.log(f"/chart/intermediate/{name}", strip, static=True)
