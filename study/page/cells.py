"""The tables of cells: models side by side with their cost, every cell, fits, and trials."""

import math
from collections.abc import Iterator, Sequence
from statistics import fmean

import pandas as pd

from paper_figs.formatting import title
from paper_figs.score_tables import MEASURES
from paper_figs.scores import in_order
from study.config.names import BEYOND, ENSEMBLE, MODELS, label
from study.metrics.tables.table import CELL, cell_name
from study.page.evidence import Evidence
from study.page.score_views import ScoreTables, score
from study.page.tables import Table, Value, figure, text

COMPARED = ("mmd2", "energy_score", "brier", "coverage_90", "variance_ratio", "epistemic_share")
"""The scores that show models side by side."""
MEGABYTE = 1e6


def side_by_side(evidence: Evidence, tables: ScoreTables) -> Iterator[Table]:
    """For each environment: the models at each level, their scores, and what a fit costs."""
    for environment in dict.fromkeys(environment for environment, _ in tables):
        by_level = {level: table for (e, level), table in tables.items() if e == environment}
        present = {metric for table in by_level.values() for metric in table}
        measures = [m for m in MEASURES if m.metric in COMPARED and m.metric in present]
        models = dict.fromkeys(m for t in by_level.values() for row in t.values() for m in row)
        yield Table(
            id=f"models-{environment}",
            caption=f"Models side by side, {label(environment)}",
            heads=["model", "level", *(m.name for m in measures), "CPU s", "memory, MB"],
            rows=[
                [
                    text(title(model)),
                    text(label(level)),
                    *(
                        score(table.get(m.metric, {}).get(model), environment, level, model, m)
                        for m in measures
                    ),
                    *_cost(evidence, environment, level, model),
                ]
                for model in models
                for level, table in by_level.items()
            ],
            tools=True,
            notes=[
                "CPU seconds: of a fit and its search for β, the mean over seeds, without the "
                "ensemble. Memory: the peak of these stages."
            ],
        )


def _cost(evidence: Evidence, environment: str, level: str, model: str) -> list[Value]:
    """CPU seconds and peak memory of a fit with its search."""
    stages = ("ensemble",) if model == ENSEMBLE else ("tune", "trial", "select", "train")
    path = [environment, level] if model == ENSEMBLE else [environment, level, model]
    seconds: dict[str, dict[str, float]] = {}
    memory = []
    for name, cost in evidence.costs.items():
        stage, _, cell = name.partition(" ")
        *cell_path, seed = cell.split("/")[: len(path) + 1]  # a trial has its number last
        if stage in stages and cell_path == path:
            by_seed = seconds.setdefault(stage, {})
            by_seed[seed] = by_seed.get(seed, 0.0) + cost.get("cpu_seconds", math.nan)
            memory.append(cost.get("peak_memory", math.nan))
    trace = f"{'/'.join(path)}\ntimings.json: {' and '.join(stages)}"
    return [
        figure(sum(fmean(s.values()) for s in seconds.values()) if seconds else None, trace, 0),
        figure(max(memory) / MEGABYTE if memory else None, trace, 0),
    ]


def cells(evidence: Evidence) -> Table:
    """Every cell: whether it has results, its scores, β and cost, and its recordings."""
    complete = [str(name) for name in evidence.facts.get("cells", _cells_of(evidence.scores))]
    table = []
    for name in [*complete, *evidence.failed]:
        parts = name.split("/")
        if len(parts) != 4:
            continue
        environment, level, model, seed = parts
        scores = cell_rows(evidence, name)
        table.append(
            [
                text(name),
                Value("failed" if name in evidence.failed else "complete"),
                *(_score(scores, metric, name) for metric in ("mmd2", "brier")),
                figure(_beta(evidence, environment, level, model, seed), "fits.parquet: beta", 1),
                Value("", links=_links(evidence.recordings, name)),
            ]
        )
    return Table(
        id="all-cells",
        caption="Cells: one for each environment, level, model and seed",
        heads=[
            "cell", "status", "MMD²", "plain Brier score", "β", "recordings",
        ],
        rows=table,
        tools=True,
    )  # fmt: skip


def _cells_of(scores: pd.DataFrame | None) -> list[str]:
    if scores is None:
        return []
    return [cell_name(row) for row in scores[[*CELL]].drop_duplicates().to_dict("records")]


def _seed(text_of_seed: str) -> float | None:
    number = text_of_seed.removeprefix("seed-")
    return float(number) if number.isdigit() else None


def cell_rows(evidence: Evidence, name: str) -> pd.DataFrame | None:
    """The scores of one cell for each scenario, over all dimensions and steps; None without any."""
    parts = name.split("/")
    if evidence.scores is None or len(parts) != 4:
        return None
    environment, level, model, seed = parts
    scores = evidence.scores
    return scores[
        (scores["environment"] == environment)
        & (scores["level"] == level)
        & (scores["model"] == model)
        & (scores["seed"] == _seed(seed))
        & (scores["dimension"] == "all")
        & (scores["step"] == -1)
        & (scores["scenario"] >= 0)
    ]


def _score(scores: pd.DataFrame | None, metric: str, name: str) -> Value:
    """The mean over the scenarios of one cell."""
    if scores is None:
        return figure(None)
    values = scores.loc[scores["metric"] == metric, "value"]
    trace = f"{name}: mean over n = {len(values)} scenarios\nscores.parquet: metric = {metric}"
    return figure(float(values.mean()) if len(values) else None, trace, 4)


def _beta(evidence: Evidence, environment: str, level: str, model: str, seed: str) -> float | None:
    if evidence.fits is None:
        return None
    fits = evidence.fits
    row = fits[
        (fits["environment"] == environment)
        & (fits["level"] == level)
        & (fits["model"] == model)
        & (fits["seed"] == _seed(seed))
    ]
    return float(row["beta"].iloc[0]) if len(row) else None


def _links(recordings: Sequence[str], name: str) -> list[tuple[str, str]]:
    folder = f"recordings/{name}/"
    return [
        (path.removeprefix(folder).removesuffix(".rrd"), path)
        for path in recordings
        if path.startswith(folder)
    ]


def shared_recordings(recordings: Sequence[str]) -> list[tuple[str, str]]:
    """The recordings of no single cell: the whole study, and the data of environments."""
    shared = [path for path in recordings if path.count("/") < 4]
    return [(path.removeprefix("recordings/").removesuffix(".rrd"), path) for path in shared]


def fits(evidence: Evidence) -> Table | None:
    """The fitted models: validation score and use of the latent variable."""
    if evidence.fits is None or evidence.fits.empty:
        return None
    names = {
        "beta": ("β", 1),
        "validation_score": ("validation MMD²", 4),
        "kl": ("KL, nats", 6),
        "active_units": ("active latent units", 0),
        "latent_share": ("latent share of variance", 3),
    }
    columns = [name for name in names if name in evidence.fits.columns]
    order = in_order(evidence.fits["model"].unique(), (*MODELS, *BEYOND))
    table = evidence.fits.assign(
        order=evidence.fits["model"].map({model: i for i, model in enumerate(order)})
    ).sort_values(["environment", "level", "order", "seed"], ascending=[True, False, True, True])
    return Table(
        id="all-fits",
        caption="Fitted models",
        heads=["environment", "level", "model", "seed", *(names[column][0] for column in columns)],
        rows=[
            [
                text(label(str(row["environment"]))),
                text(label(str(row["level"]))),
                text(label(str(row["model"]))),
                text(row["seed"], order=float(row["seed"])),
                *(
                    figure(
                        float(row[column]),
                        f"{cell_name(row)}\nfits.parquet: {column}",
                        names[column][1],
                    )
                    for column in columns
                ),
            ]
            for row in table.to_dict("records")
        ],
        tools=True,
    )
