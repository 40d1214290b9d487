"""The recording of a cell's scores: the same numbers as in its table, over the horizon."""

from pathlib import Path

import numpy as np
import pandas as pd
import rerun as rr

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
}
# Over the horizon these are recorded; the table holds more.
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
# Right is 1.
_RATIOS = ("variance_ratio", "aleatoric_ratio")
# Of these the table names outcomes in place of dimensions.
_OF_OUTCOMES = ("brier", "forecast_probability", "observed_probability")
_OVERVIEW = "Overview"
_PAGES = dict.fromkeys(_RATIOS, "Variances") | {"mmd2_joint": "By dimension"}
_README = """
# Scores

How well the forecasts of this cell agree with what was observed, on the test scenarios.

- **MMD²** (Gaussian kernel; lower is better, 0 if the two distributions are the same) at each step
  of the horizon, averaged over dimensions, and for each dimension.
- **Variance ratio**: the forecasts' variance over the observed; 1 is right, less is too sure of
  itself, more is too cautious.
- **Aleatoric ratio**: the same for what the model holds to be aleatoric. Above 1 with little data,
  epistemic uncertainty has been counted twice.
- **CRPS** in standard deviations of the training data: the error of the whole distribution.
- **Coverage**: the share of what was observed that lies in the forecasts' central intervals.
- **Reliability**: one dot a scenario; of the scenarios to which the model gives a probability p, a
  share p should succeed. The line joins the means of ten bins; on the diagonal is right.
"""


def record_scores(path: Path, scores: pd.DataFrame, properties: Properties) -> None:
    """Write the recording of one cell's tidy scores.

    Args:
        path: the recording.
        scores: columns metric, dimension, step, scenario, value; "all", −1 and −1 mean the average
            over that axis. By step: `/metric/dimension` on the timeline `horizon`. By scenario:
            `/by_scenario/metric` on the timeline `scenario`. Overall: in the README panel, and as
            `/overall/metric/all` at step 0, with a column a dimension in
            `/overall/metric/dimensions`. What is both by step and by scenario, and the variants
            of a metric, are left to the table.
        properties: of the recording.
    """
    stepwise = scores[(scores["step"] >= 0) & (scores["scenario"] < 0)]
    stepwise = stepwise[stepwise["metric"].isin((*_STEPWISE, *_COVERAGES))]
    by_scenario = scores[(scores["scenario"] >= 0) & (scores["step"] < 0)]
    by_scenario = by_scenario[by_scenario["dimension"] == "all"]
    by_scenario = by_scenario[by_scenario["metric"].isin(_BY_SCENARIO)]
    overall = scores[(scores["scenario"] < 0) & (scores["step"] < 0)]
    overall = overall[~overall["metric"].str.startswith("pit_")]
    reliable = {"forecast_probability", "observed_probability"} <= set(by_scenario["metric"])

    design = blueprints.scores(_pages(stepwise), reliable)
    # Hundreds of small entities: an index of them would be larger than what it points to.
    with recording(path, KIND, properties, design, footer=False) as stream:
        write_readme(stream, _README + _overall_table(overall), properties)
        _log_overall(stream, overall)
        for metric, rows in stepwise.groupby("metric", sort=False):
            _log_metric(stream, str(metric), rows)
        for metric, rows in by_scenario.groupby("metric", sort=False):
            ordered = rows.sort_values("scenario")
            entity = entity_path("by_scenario", str(metric))
            send_scalars(
                stream, entity, "scenario", ordered["scenario"], finite(ordered["value"].to_numpy())
            )
        if reliable:
            _log_reliability(stream, by_scenario)


def reliability(
    forecast: np.ndarray, observed: np.ndarray, bins: int = _BINS
) -> tuple[np.ndarray, np.ndarray]:
    """Mean forecast probability and mean observed frequency of each bin that is not empty."""
    place = np.clip((forecast * bins).astype(int), 0, bins - 1)
    count = np.bincount(place, minlength=bins)
    full = count > 0
    promised = np.bincount(place, forecast, bins)[full] / count[full]
    came_true = np.bincount(place, observed, bins)[full] / count[full]
    return promised, came_true


def _pages(stepwise: pd.DataFrame) -> dict[str, dict[str, list[str]]]:
    """Views, by title and page: each metric averaged over dimensions, and by dimension."""
    pages: dict[str, dict[str, list[str]]] = {}
    for metric, rows in stepwise.groupby("metric", sort=False):
        if metric in _COVERAGES:
            entities = [f"{entity_path(str(metric))}/{name}" for name in ("all", "reference")]
            overview = pages.setdefault(_OVERVIEW, {})
            overview.setdefault("Coverage of central intervals", []).extend(entities)
            continue
        title = _TITLES.get(str(metric), str(metric).replace("_", " "))
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
    place = 0
    for dimension, part in rows.groupby("dimension", sort=False):
        ordered = part.sort_values("step")
        entity = entity_path(metric, str(dimension))
        send_scalars(stream, entity, TIMELINE, ordered["step"], finite(ordered["value"].to_numpy()))
        if dimension == "all":
            style_lines(stream, entity, [metric], [FORECAST], 3.0)
        else:
            style_lines(stream, entity, [str(dimension)], [series(place)])
            place += 1
    if metric in (*_RATIOS, *_COVERAGES):
        right = 1.0 if metric in _RATIOS else int(metric.removeprefix("coverage_")) / 100
        steps = np.sort(rows["step"].unique())
        entity = entity_path(metric, "reference")
        send_scalars(stream, entity, TIMELINE, steps, np.full(len(steps), right))
        style_lines(stream, entity, ["right"], [REFERENCE])


def _log_overall(stream: rr.RecordingStream, overall: pd.DataFrame) -> None:
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
    """The overall numbers: those over all dimensions, then those by dimension."""
    if overall.empty:
        return ""
    whole = overall["dimension"] == "all"
    rows = [
        (_TITLES.get(m, m.replace("_", " ")), f"**{v:.4g}**")
        for m, v in overall.loc[whole, ["metric", "value"]].itertuples(index=False)
    ]
    text = f"\n## Overall\n\n{table(('metric', 'value'), rows)}\n" if rows else ""
    of_outcomes = overall["metric"].str.startswith(_OF_OUTCOMES)
    for title, chosen in (("dimension", ~of_outcomes), ("outcome", of_outcomes)):
        text += _table_apart(title, overall[~whole & chosen])
    return text


def _table_apart(title: str, apart: pd.DataFrame) -> str:
    if apart.empty:
        return ""
    wide = apart.pivot_table(index="dimension", columns="metric", values="value", sort=False)
    cells = [
        (str(dimension), *(f"{value:.4g}" for value in values))
        for dimension, values in zip(wide.index, wide.to_numpy(), strict=True)
    ]
    header = (title, *(_TITLES.get(m, m.replace("_", " ")) for m in wide.columns))
    return f"\n## By {title}\n\n{table(header, cells)}\n"


def _log_reliability(stream: rr.RecordingStream, by_scenario: pd.DataFrame) -> None:
    wide = by_scenario.pivot_table(index="scenario", columns="metric", values="value")
    forecast = wide["forecast_probability"].to_numpy()
    observed = wide["observed_probability"].to_numpy()
    known = np.isfinite(forecast) & np.isfinite(observed)
    forecast, observed = forecast[known], observed[known]
    chart = Chart(Axis("forecast probability", 0.0, 1.0), Axis("observed frequency", 0.0, 1.0))
    root = "/chart/reliability"
    chart.draw(stream, root)
    diagonal = rr.LineStrips2D(
        [np.array([[0.0, 0.0], [WIDTH, -1.0]])], colors=[REFERENCE], radii=rr.Radius.ui_points(1.0)
    )
    stream.log(f"{root}/diagonal", diagonal, static=True)
    dots = rr.Points2D(
        chart.place(forecast, observed),
        colors=[faint(FORECAST, 110)],
        radii=rr.Radius.ui_points(3.0),
    )
    stream.log(f"{root}/scenarios", dots, static=True)
    bins = chart.place(*reliability(forecast, observed))
    line = rr.LineStrips2D([bins], colors=[FORECAST], radii=rr.Radius.ui_points(2.0))
    stream.log(f"{root}/bins", line, static=True)
    knots = rr.Points2D(bins, colors=[FORECAST], radii=rr.Radius.ui_points(5.0))
    stream.log(f"{root}/knots", knots, static=True)
