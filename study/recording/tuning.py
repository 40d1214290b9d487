"""``tuning.rrd``: the search for β, with the β and the score of every trial."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from study.common.arrays import Doubles
from study.common.files import read_json
from study.plotting.palette import FORECAST, TARGET, TRIAL_STATES, faint
from study.recording import blueprints
from study.recording.charts import Axis, Chart
from study.recording.properties import Properties, table, write_readme
from study.recording.streams import finite, recording, send_scalars

KIND = "tuning"
TIMELINE = "trial"
_README = """
# Tuning β

β weighs the Kullback–Leibler term in the loss of the variational autoencoder (the paper's equation
12). The study searches for it with Optuna. Each *trial* trains a model with one β for a short time.
Its score compares autoregressive forecasts with *validation* trajectories; test scenarios are not
used. Lower is better.

- *Score of each β*: a dot for each trial. The large dot is the best β, which the study uses.
- *Intermediate scores*: the score of each trial during its training.
- *Score and best so far*, *log₁₀ β*: the trials in their order. The first half of the trials covers
  the range of log β evenly. The second half is close to the best values.

**Green**: complete. **Orange**: pruned, that is, stopped early because its intermediate scores were
worse than those of other trials. **Red**: failed.
"""


@dataclass(frozen=True)
class Trial:
    """One trial of a search.

    Attributes:
        number: the position in the search, from 0.
        beta: the β of the trial.
        state: "complete", "pruned" or "failed".
        score: the last score; None without a score.
        intermediate: the scores during training, by optimiser step.
    """

    number: int
    beta: float
    state: str
    score: float | None
    intermediate: dict[int, float]


def read_trials(path: Path) -> list[Trial]:
    """Read the trials in a ``tuning.json`` of the stage tune."""
    return [
        Trial(
            int(trial["number"]),
            float(trial["beta"]),
            str(trial["state"]),
            trial["score"],
            {int(step): float(score) for step, score in trial["intermediate"].items()},
        )
        for trial in read_json(path)["trials"]
    ]


def record_tuning(path: Path, trials: Sequence[Trial], properties: Properties) -> None:
    """Write the recording of a search.

    `/beta`, `/log10_beta`, `/score/STATE` and `/best` hold a value for each trial on the timeline
    `trial`. `/intermediate/trial_N` holds the scores of a trial on the timeline `step`.

    Args:
        path: the recording.
        trials: all trials of the search.
        properties: of the recording.
    """
    trials = sorted(trials, key=lambda trial: trial.number)
    numbers = np.array([trial.number for trial in trials], dtype=np.int64)
    betas = np.array([trial.beta for trial in trials], dtype=np.float64)
    scores = finite(np.array([trial.score for trial in trials], dtype=np.float64))
    states = np.array([trial.state for trial in trials])
    best = best_so_far(np.where(states == "complete", scores, np.nan))

    # The index of many small entities would be larger than their data.
    with recording(path, KIND, properties, blueprints.tuning(), footer=False) as stream:
        write_readme(stream, _README + _table(trials, best), properties)
        if not trials:
            return
        for entity, values in (("/beta", betas), ("/log10_beta", np.log10(betas)), ("/best", best)):
            send_scalars(stream, entity, TIMELINE, numbers, values)
        steps = rr.components.InterpolationMode.StepAfter
        curve = rr.SeriesLines(
            names="best so far", colors=TARGET, widths=2.5, interpolation_mode=steps
        )
        stream.log("/best", curve, static=True)
        dots = rr.SeriesPoints(colors=FORECAST, names="log₁₀ β", marker_sizes=5.0)
        stream.log("/log10_beta", dots, static=True)
        for state, colour in TRIAL_STATES.items():
            rows = np.flatnonzero(states == state)
            if len(rows):
                send_scalars(stream, f"/score/{state}", TIMELINE, numbers[rows], scores[rows])
                dots = rr.SeriesPoints(colors=colour, names=state, marker_sizes=5.0)
                stream.log(f"/score/{state}", dots, static=True)
        _log_beta_chart(stream, trials, betas, scores, best)
        _log_intermediate_chart(stream, trials)


def best_so_far(scores: Doubles) -> Doubles:
    """The running minimum [N] of scores [N]; NaN before the first score that is not NaN."""
    return np.asarray(np.fmin.accumulate(scores))


def _best_index(best: Doubles) -> int | None:
    """The row of the best trial; None if no trial is complete."""
    if not np.isfinite(best).any():
        return None
    return int(np.flatnonzero(best == np.nanmin(best))[0])


def _table(trials: Sequence[Trial], best: Doubles) -> str:
    """The best β, and a table of all trials."""
    index = _best_index(best)
    headline = (
        "No trial is complete."
        if index is None
        else f"**Best: β = {trials[index].beta:.4g}**, score {best[index]:.4g} "
        f"(trial {trials[index].number} of {len(trials)})."
    )
    rows = [
        (
            str(trial.number),
            f"{trial.beta:.4g}",
            "–" if trial.score is None else f"{trial.score:.4g}",
            trial.state,
        )
        for trial in trials
    ]
    return f"\n{headline}\n\n{table(('trial', 'β', 'score', 'state'), rows)}\n"


def _log_beta_chart(
    stream: rr.RecordingStream,
    trials: Sequence[Trial],
    betas: Doubles,
    scores: Doubles,
    best: Doubles,
) -> None:
    """Log the score over β, a static dot for each trial."""
    chart = Chart(Axis.around("β", betas, logarithmic=True), Axis.around("score", scores))
    chart.log_axes(stream, "/chart/beta")
    best_index = _best_index(best)
    for index, trial in enumerate(trials):
        point = chart.points(betas[index : index + 1], scores[index : index + 1])
        if not len(point):
            continue
        dot = rr.Points2D(
            point,
            colors=[TRIAL_STATES[trial.state]],
            radii=rr.Radius.ui_points(8.0 if index == best_index else 4.5),
        )
        stream.log(f"/chart/beta/trial_{trial.number}", dot, static=True)


def _log_intermediate_chart(stream: rr.RecordingStream, trials: Sequence[Trial]) -> None:
    """Log the intermediate scores of each trial: as a static curve, and as scalars by step."""
    pairs: list[Any] = [
        np.array(sorted(trial.intermediate.items()), dtype=np.float64).reshape(-1, 2)
        for trial in trials
    ]
    steps, scores = np.concatenate(pairs).T
    chart = Chart(Axis.around("step", steps), Axis.around("score", scores))
    chart.log_axes(stream, "/chart/intermediate")
    for trial, curve in zip(trials, pairs, strict=True):
        if not len(curve):
            continue
        name = f"trial_{trial.number}"
        steps, scores = curve.T
        send_scalars(stream, f"/intermediate/{name}", "step", steps, finite(scores))
        strip = rr.LineStrips2D(
            [chart.points(steps, scores)],
            colors=[faint(TRIAL_STATES[trial.state], 200)],
            radii=rr.Radius.ui_points(1.5),
        )
        stream.log(f"/chart/intermediate/{name}", strip, static=True)
