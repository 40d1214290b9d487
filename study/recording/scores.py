"""``scores.rrd``: the scores of a cell over the horizon, by dimension and by scenario."""

from pathlib import Path

import numpy as np
import pandas as pd
import rerun as rr

from study.common.arrays import Doubles
from study.plotting.palette import FORECAST, REFERENCE, faint, series
from study.recording import blueprints
from study.recording.charts import WIDTH, Axis, Chart
from study.recording.properties import Properties, table, write_readme
from study.recording.streams import entity_path, finite, recording, send_scalars, style_lines

KIND = "scores"
TIMELINE = "horizon"
_BINS = 10
_TITLES = {
    "mmd2": "MMD²",
    "mmd": "MMD",
    "mmd2_joint": "joint MMD²",
    "crps": "CRPS",
    "energy_score": "energy score",
    "variance_ratio": "variance ratio",
    "aleatoric_ratio": "aleatoric ratio",
    "epistemic_share": "epistemic share",
    "forecast_probability": "forecast probability",
    "observed_probability": "observed frequency",
    "coverage_50": "coverage of 50 % intervals",
    "coverage_80": "coverage of 80 % intervals",
    "coverage_90": "coverage of 90 % intervals",
}
# The metrics over the horizon and the metrics by scenario in a recording. The table has more.
_STEPWISE = ("mmd2", "mmd2_joint", "crps", "variance_ratio", "aleatoric_ratio")
_BY_SCENARIO = (
    "mmd2",
    "brier",
    "crps",
    "energy_score",
    "forecast_probability",
    "observed_probability",
)
_COVERAGES = ("coverage_50", "coverage_80", "coverage_90")
# Metrics whose ideal value is 1.
_RATIOS = ("variance_ratio", "aleatoric_ratio")
# Metrics whose dimension, in the table of scores, is the name of an outcome.
_OF_OUTCOMES = ("brier", "forecast_probability", "observed_probability")
_OVERVIEW = "Overview"
_PAGES = dict.fromkeys(_RATIOS, "Variances") | {"mmd2_joint": "By dimension"}
_README = """
# Scores

The scores compare the forecasts of this cell with the observed trajectories of the test scenarios.
In the plots, **blue** is the average over all dimensions of the state. Grey is the ideal value.

- **MMD²** (maximum mean discrepancy, with a Gaussian kernel): the distance between the forecast and
  the observed distribution at each step. Lower is better. It is 0 if the distributions are equal.
- **CRPS** (continuous ranked probability score): the error of the whole distribution, in standard
  deviations of the training data. Lower is better.
- **Coverage of central intervals**: the share of observed values in the 50, 80 and 90 % intervals
  of the forecast. Below the ideal value, the forecast is overconfident.
- **Reliability**: a faint dot for each scenario. Of the rollouts of
  all scenarios with a forecast probability p, a share p should succeed. The line joins the means of
  ten bins. The ideal line is the diagonal.
- **Variance ratio**, on the tab *Variances*: forecast variance over observed variance. The ideal is
  1. Below 1 the forecast is overconfident, above 1 underconfident. Here it is an average over
  all steps; the tables of the study have the median from step 11 on.
- **Aleatoric ratio**: aleatoric forecast variance over observed variance. Above 1
  the model overestimates the noise: it may count epistemic uncertainty as aleatoric.
"""


_ONCE = """
Each scenario was observed once. So there are no ratios of variances, an observed frequency is 0 or
1, and MMD² is that against one observation: lower is better, but the lowest value is not 0.
"""


def record_scores(path: Path, scores: pd.DataFrame, properties: Properties) -> None:
    """Write the recording of one cell's scores.

    `/METRIC/DIMENSION` holds a metric over the horizon, on the timeline `horizon`.
    `/by_scenario/METRIC` holds a metric of each scenario, on the timeline `scenario`.
    `/overall/METRIC/all` and `/overall/METRIC/dimensions` (a column for each dimension) hold
    averages, at step 0. The recording leaves out variants of a metric, and metrics that are by step
    and by scenario.

    Args:
        path: the recording.
        scores: the tidy scores of the cell; see `study.metrics.tables.table`.
        properties: of the recording.
    """
    stepwise = scores[(scores["step"] >= 0) & (scores["scenario"] < 0)]
    stepwise = stepwise[stepwise["metric"].isin((*_STEPWISE, *_COVERAGES))]
    by_scenario = scores[(scores["scenario"] >= 0) & (scores["step"] < 0)]
    by_scenario = by_scenario[by_scenario["dimension"] == "all"]
    by_scenario = by_scenario[by_scenario["metric"].isin(_BY_SCENARIO)]
    overall = scores[(scores["scenario"] < 0) & (scores["step"] < 0)]
    overall = overall[~overall["metric"].str.startswith("pit_")]
    has_outcomes = {"forecast_probability", "observed_probability"} <= set(by_scenario["metric"])

    design = blueprints.scores(_pages(stepwise), has_outcomes)
    # The index of hundreds of small entities would be larger than their data.
    with recording(path, KIND, properties, design, footer=False) as stream:
        once = "" if "variance_ratio" in set(stepwise["metric"]) else _ONCE
        write_readme(stream, _README + once + _overall_table(overall), properties)
        _log_overall(stream, overall)
        for metric, rows in stepwise.groupby("metric", sort=False):
            _log_metric(stream, str(metric), rows)
        for metric, rows in by_scenario.groupby("metric", sort=False):
            ordered = rows.sort_values("scenario")
            entity = entity_path("by_scenario", str(metric))
            send_scalars(
                stream, entity, "scenario", ordered["scenario"], finite(ordered["value"].to_numpy())
            )
        if has_outcomes:
            _log_reliability(stream, by_scenario)


def reliability(forecast: Doubles, observed: Doubles, bins: int = _BINS) -> tuple[Doubles, Doubles]:
    """Mean forecast probability and mean observed frequency of each bin that is not empty.

    Args:
        forecast: [S], forecast probabilities of success.
        observed: [S], observed frequencies.
        bins: the number of equal bins of the forecast probability.
    """
    index = np.clip((forecast * bins).astype(int), 0, bins - 1)
    count = np.bincount(index, minlength=bins)
    filled = count > 0
    probability = np.bincount(index, forecast, bins)[filled] / count[filled]
    frequency = np.bincount(index, observed, bins)[filled] / count[filled]
    return probability, frequency


def _title(metric: str) -> str:
    """The name of a metric in text."""
    return _TITLES.get(metric, metric.replace("_", " "))


def _pages(stepwise: pd.DataFrame) -> dict[str, dict[str, list[str]]]:
    """The entities of each view, by page and title of the view."""
    pages: dict[str, dict[str, list[str]]] = {}
    for metric, rows in stepwise.groupby("metric", sort=False):
        if metric in _COVERAGES:
            entities = [f"{entity_path(str(metric))}/{name}" for name in ("all", "reference")]
            overview = pages.setdefault(_OVERVIEW, {})
            overview.setdefault("Coverage of central intervals", []).extend(entities)
            continue
        title = _title(str(metric))
        folder = entity_path(str(metric))
        dimensions = [d for d in rows["dimension"].unique() if d != "all"]
        if "all" in set(rows["dimension"]):
            page = pages.setdefault(_PAGES.get(str(metric), _OVERVIEW), {})
            page[f"{title}, all dimensions"] = [f"{folder}/all", f"{folder}/reference"]
        if dimensions:
            page = pages.setdefault(_PAGES.get(str(metric), "By dimension"), {})
            listed = [entity_path(str(metric), str(d)) for d in dimensions]
            page[f"{title} of each dimension"] = [*listed, f"{folder}/reference"]
    order = (_OVERVIEW, "By dimension", "Variances")
    return {name: pages[name] for name in order if name in pages}


def _log_metric(stream: rr.RecordingStream, metric: str, rows: pd.DataFrame) -> None:
    """Log a metric over the horizon: averaged, by dimension, and its ideal value."""
    dimensions = 0
    for dimension, part in rows.groupby("dimension", sort=False):
        ordered = part.sort_values("step")
        entity = entity_path(metric, str(dimension))
        send_scalars(stream, entity, TIMELINE, ordered["step"], finite(ordered["value"].to_numpy()))
        if dimension == "all":
            style_lines(stream, entity, [_title(metric)], [FORECAST], 3.0)
        else:
            style_lines(stream, entity, [str(dimension)], [series(dimensions)])
            dimensions += 1
    if metric in (*_RATIOS, *_COVERAGES):
        ideal = 1.0 if metric in _RATIOS else int(metric.removeprefix("coverage_")) / 100
        steps = np.sort(rows["step"].unique())
        entity = entity_path(metric, "reference")
        send_scalars(stream, entity, TIMELINE, steps, np.full(len(steps), ideal))
        style_lines(stream, entity, ["ideal"], [REFERENCE])


def _log_overall(stream: rr.RecordingStream, overall: pd.DataFrame) -> None:
    """Log averages over the horizon and over scenarios, for all dimensions and by dimension."""
    for metric, rows in overall.groupby("metric", sort=False):
        by_dimension = rows[rows["dimension"] != "all"]
        names = list(by_dimension["dimension"])
        several = len(names) > 1
        for name, value in rows[["dimension", "value"]].itertuples(index=False):
            if name == "all" or not several:
                entity = entity_path("overall", str(metric), str(name))
                send_scalars(stream, entity, TIMELINE, [0], finite(np.array([value])))
        if several:
            entity = entity_path("overall", str(metric), "dimensions")
            style_lines(stream, entity, names, [series(i) for i in range(len(names))])
            values = finite(by_dimension["value"].to_numpy())
            send_scalars(stream, entity, TIMELINE, [0], values[None])


def _overall_table(overall: pd.DataFrame) -> str:
    """The averages in Markdown: over all dimensions, by dimension, and by outcome."""
    if overall.empty:
        return ""
    averaged = overall["dimension"] == "all"
    rows = [
        (_title(m), f"**{v:.4g}**")
        for m, v in overall.loc[averaged, ["metric", "value"]].itertuples(index=False)
    ]
    text = f"\n## Overall\n\n{table(('metric', 'value'), rows)}\n" if rows else ""
    by_outcome = overall["metric"].str.startswith(_OF_OUTCOMES)
    for title, selected in (("dimension", ~by_outcome), ("outcome", by_outcome)):
        text += _table_by(title, overall[~averaged & selected])
    return text


def _table_by(title: str, rows: pd.DataFrame) -> str:
    """A Markdown table with a row for each dimension or outcome."""
    if rows.empty:
        return ""
    wide = rows.pivot_table(index="dimension", columns="metric", values="value", sort=False)
    cells = [
        (str(dimension), *(f"{value:.4g}" for value in values))
        for dimension, values in zip(wide.index, wide.to_numpy(), strict=True)
    ]
    header = (title, *(_title(str(m)) for m in wide.columns))
    return f"\n## By {title}\n\n{table(header, cells)}\n"


def _log_reliability(stream: rr.RecordingStream, by_scenario: pd.DataFrame) -> None:
    """Log the reliability diagram of the probability of success."""
    wide = by_scenario.pivot_table(index="scenario", columns="metric", values="value")
    forecast = wide["forecast_probability"].to_numpy()
    observed = wide["observed_probability"].to_numpy()
    defined = np.isfinite(forecast) & np.isfinite(observed)
    forecast, observed = forecast[defined], observed[defined]
    chart = Chart(Axis("forecast probability", 0.0, 1.0), Axis("observed frequency", 0.0, 1.0))
    root = "/chart/reliability"
    chart.log_axes(stream, root)
    diagonal = rr.LineStrips2D(
        [np.array([[0.0, 0.0], [WIDTH, -1.0]])], colors=[REFERENCE], radii=rr.Radius.ui_points(1.0)
    )
    stream.log(f"{root}/diagonal", diagonal, static=True)
    dots = rr.Points2D(
        chart.points(forecast, observed),
        colors=[faint(FORECAST, 110)],
        radii=rr.Radius.ui_points(3.0),
    )
    stream.log(f"{root}/scenarios", dots, static=True)
    bins = chart.points(*reliability(forecast, observed))
    line = rr.LineStrips2D([bins], colors=[FORECAST], radii=rr.Radius.ui_points(2.0))
    stream.log(f"{root}/bins", line, static=True)
    means = rr.Points2D(bins, colors=[FORECAST], radii=rr.Radius.ui_points(5.0))
    stream.log(f"{root}/means", means, static=True)
