"""The files of a results folder about the whole study, written from the scores of its cells.

These are ``study.json``, ``scores.parquet``, ``trials.parquet``, ``fits.parquet``, the verdicts on
the claims, tables, figures, and ``recordings/study.rrd``. A cell that failed or has not run has no
scores. The tables show which of the two it is.
"""

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from study import __version__
from study.claims import report
from study.claims.judge import CLAIMS as ALL_CLAIMS
from study.claims.judge import judge
from study.common.errors import StudyError
from study.common.files import read_json, replacing, write_json, write_text
from study.common.plugins import reason
from study.common.provenance import made_with
from study.config.grid import Cell
from study.config.names import ENVIRONMENTS
from study.config.settings import Config
from study.metrics.tables.table import CELL
from study.results.folder import FORMAT, STUDY, STUDY_RECORDING, settings_of
from study.results.origin import Origin, of_tasks, to_json
from study.workflow.store import Store
from study.workflow.task import Task
from study.workflow.task_cache import topological_order

SCORES, TRIALS, FITS = "scores.parquet", "trials.parquet", "fits.parquet"
CLAIMS, VERDICTS = "claims.json", "claims.md"
DIAGNOSTICS = ("beta", "validation_score", "kl", "active_units", "latent_share")
"""The columns of ``fits.parquet`` beside those of the cell: numbers of ``fit.json``."""
PLOTTED = ("tables", "figures")
"""Folders of the tables and figures."""
DOCUMENTS = {
    "Brier scores": "tables/brier_*.md",
    "Claims": VERDICTS,
    "Scores": "tables/scores_*.md",
}
"""The text documents of the study's recording: title, and the files to show."""


@dataclass(frozen=True)
class Summary:
    """A whole study, without the recordings and weights of its cells.

    Attributes:
        config: settings of the study.
        complete: the cells that have results, in the order of the grid.
        failed: names of the cells without results because a stage failed.
        scores: of the complete cells in their order, in single precision.
        trials: of the searches for β of the complete cells.
        fits: β, validation score and posterior statistics of the fitted models.
        origin: versions, device and source of the results.
    """

    config: Config
    complete: Sequence[Cell]
    failed: Sequence[str]
    scores: pd.DataFrame
    trials: pd.DataFrame
    fits: pd.DataFrame
    origin: Origin


def collect(
    config: Config, complete: Mapping[Cell, Task], failed: Sequence[str], store: Store
) -> Summary:
    """The summary of cells from their stages.

    Args:
        config: settings of the study.
        complete: the last task of every cell that has results.
        failed: names of the cells that failed.
        store: the folders of the tasks.
    """
    tables = [
        pd.read_parquet(store.folder(task.inputs["evaluation"]) / SCORES).assign(**asdict(cell))
        for cell, task in complete.items()
    ]
    scores = pd.concat(tables, ignore_index=True)
    columns = [*CELL, "metric", "dimension", "step", "scenario", "value"]
    scores = single_precision(scores[columns])
    origin = of_tasks(topological_order(complete.values()), store)
    trials, fits = _trials(complete, store), _fits(complete, store)
    return Summary(config, list(complete), failed, scores, trials, fits, origin)


def single_precision(scores: pd.DataFrame) -> pd.DataFrame:
    """Scores rounded to float32. Forecasts are float32, so more digits have no information.

    The type of the column stays float64, so that sums over the scores are in double precision.
    """
    return scores.assign(value=scores.value.astype(np.float32).astype(np.float64))


def write(summary: Summary, out: Path) -> None:
    """Write all files about the whole study. The recordings of the cells must be in `out`.

    Raises:
        StudyError: a figure or the recording of the study could not be written. All other files
            are written, including the scores.
    """
    _write_parquet(summary.scores, out / SCORES)
    _write_parquet(summary.trials, out / TRIALS)
    _write_parquet(summary.fits, out / FITS)
    write_claims(summary.scores, out)
    write_json(
        out / STUDY,
        {
            "format": FORMAT,
            "study": __version__,
            "settings": settings_of(summary.config),
            "cells": [cell.name for cell in summary.complete],
            "failed": summary.failed,
            **to_json(summary.origin),
        },
    )
    for folder in PLOTTED:
        shutil.rmtree(out / folder, ignore_errors=True)
    run_each(lambda: plot(out), lambda: _record(summary, out))


def run_each(*steps: Callable[[], object]) -> None:
    """Run all steps, even if one of them fails.

    Raises:
        StudyError: steps failed; the error names the reason of each.
        OSError: a file could not be written, which ends the steps.
    """
    problems = []
    for step in steps:
        try:
            step()
        except OSError:
            raise
        except Exception as error:
            problems.append(str(error) if isinstance(error, StudyError) else reason(error))
    if problems:
        raise StudyError("; ".join(problems))


def write_claims(scores: pd.DataFrame, out: Path) -> None:
    """Write the verdict on every claim, as JSON and as a page.

    A study with none of the paper's environments has no claims.
    """
    is_of_paper = scores.environment.isin(ENVIRONMENTS).any()
    verdicts = judge(scores, ALL_CLAIMS if is_of_paper else ())
    write_text(out / CLAIMS, report.to_json(verdicts))
    write_text(out / VERDICTS, report.to_markdown(verdicts))


def plot(out: Path) -> list[Path]:
    """Write all tables and figures from the scores in `out`, and remove obsolete ones.

    Returns:
        paths of the tables and figures.
    """
    from paper_figs import all as scripts

    paths = scripts.plot(out)
    for folder in PLOTTED:
        for path in (out / folder).glob("*"):
            if path not in paths:
                path.unlink()
    return paths


def _trials(complete: Mapping[Cell, Task], store: Store) -> pd.DataFrame:
    """A table with a row for every trial of every search for β."""
    rows: list[dict[str, Any]] = []
    for cell, task in complete.items():
        if "tuning" in task.inputs:
            tuning = read_json(store.folder(task.inputs["tuning"]) / "tuning.json")
            rows += [
                asdict(cell)
                | {name: trial[name] for name in ("number", "state", "beta")}
                | {"value": trial["score"], "chosen": trial["beta"] == tuning["beta"]}
                for trial in tuning["trials"]
            ]
    columns = [*CELL, "number", "state", "beta", "value", "chosen"]
    return pd.DataFrame(rows, columns=columns)


def _fits(complete: Mapping[Cell, Task], store: Store) -> pd.DataFrame:
    """A table with a row for every fitted model. What a model does not have is NaN."""
    rows = []
    for cell, task in complete.items():
        if "trained" in task.inputs:
            fit = read_json(store.folder(task.inputs["trained"]) / "fit.json")
            rows.append(asdict(cell) | {name: fit.get(name) for name in DIAGNOSTICS})
    return fits_table(rows)


def fits_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """The table ``fits.parquet`` from its rows."""
    table = pd.DataFrame(rows, columns=[*CELL, *DIAGNOSTICS])
    return table.astype(dict.fromkeys(DIAGNOSTICS, np.float64))


def _write_parquet(table: pd.DataFrame, path: Path) -> None:
    numbers = list(table.select_dtypes("float64"))
    with replacing(path) as temporary:
        # In separate streams of bytes, the zero bytes of the single-precision values are adjacent,
        # so that they compress well.
        table.to_parquet(
            temporary,
            index=False,
            compression="zstd",
            use_dictionary=[name for name in table if name not in numbers],
            use_byte_stream_split=numbers,
        )


def _record(summary: Summary, out: Path) -> None:
    """Write the recording of the whole study, from the other files in `out`."""
    from study.recording.study import record_study

    properties = {
        "study": summary.config.name,
        "seeds": ", ".join(map(str, summary.config.grid.seeds)),
        **made_with(),
        "versions": json.dumps(summary.origin.versions, sort_keys=True),
        "config": json.dumps(settings_of(summary.config), sort_keys=True),
    }
    documents = {
        title: [path.read_text(encoding="utf-8") for path in sorted(out.glob(pattern))]
        for title, pattern in DOCUMENTS.items()
    }
    texts = {title: "\n\n".join(parts) for title, parts in documents.items() if parts}
    record_study(out / STUDY_RECORDING, summary.scores, texts, properties)
