"""Evaluate a cell of a results folder again from its weights, and compare the scores.

On the same machine, with the same versions, the scores are the same to the last bit. Another
processor or version rounds differently, and a forecast propagates the difference from step to step.
It may then cross a threshold, which changes the probability of one scenario by 1/K. `TOLERANCE` and
`SHARE` allow for these differences.
"""

import tempfile
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd

from study.common.progress import Progress
from study.config.grid import Cell
from study.config.settings import Engine
from study.results import summary
from study.results.folder import Results
from study.results.weights import write_checkpoint
from study.workflow.pipeline import Pipeline
from study.workflow.store import Store
from study.workflow.worker import prepare, run_stage

TOLERANCE = 0.001
"""Allowed difference of a score: absolute up to a score of 1, relative above. Tables have three
digits."""
SHARE = 0.99
"""Share of all scores that must be within the tolerance. Every score over all scenarios must be."""
KEYS = ["metric", "dimension", "step", "scenario"]


def published_scores(results: Results, cell: Cell) -> pd.DataFrame:
    """The scores of one cell in ``scores.parquet``."""
    scores = pd.read_parquet(results.out / summary.SCORES)
    rows = np.logical_and.reduce([scores[name] == value for name, value in asdict(cell).items()])
    return scores[rows].reset_index(drop=True)


def evaluate(results: Results, cell: Cell, progress: Progress) -> pd.DataFrame:
    """The scores of a new evaluation of a cell from its weights.

    The test scenarios are simulated again, unless ``work/`` has them.

    Raises:
        StudyError: the weights are not published, missing or damaged.
    """
    task = Pipeline(results.config).evaluate(cell)
    prepare(results.config.plugins, Engine().threads)
    with tempfile.TemporaryDirectory(prefix="study-verify-") as temporary:
        out, model, data = (Path(temporary, name) for name in ("evaluate", "model", "data"))
        for folder in (out, model, data):
            folder.mkdir()
        write_checkpoint(results, cell, model)
        store, collect = Store(results.out / "work"), task.inputs["data"]
        if store.reason_to_run(collect) is None:
            data = store.folder(collect)
        else:
            run_stage(collect, {}, data, progress.part(0.0, 0.6))
        inputs = {"data": data, "trained": model, "ensemble": model}
        run_stage(task, inputs, out, progress.part(0.6, 1.0))
        return summary.single_precision(pd.read_parquet(out / summary.SCORES))


def compare(name: str, published: pd.DataFrame, repeated: pd.DataFrame) -> tuple[bool, str]:
    """Compare the published scores of a cell with those of a new evaluation.

    Args:
        name: of the cell.
        published: columns `KEYS` and ``value``.
        repeated: the same columns.

    Returns:
        whether the scores agree, and a sentence about their differences.
    """
    if not published[KEYS].astype(str).equals(repeated[KEYS].astype(str)):
        counts = f"{len(published)} scores are published, the new evaluation has {len(repeated)}"
        return False, f"{name}: {counts}, and they are not of the same metrics and scenarios"
    old, new = (table.value.to_numpy(np.float64) for table in (published, repeated))
    if np.array_equal(old, new, equal_nan=True):
        return True, f"{name}: {len(old)} scores of a new evaluation, all the same numbers"
    with np.errstate(invalid="ignore"):
        difference = np.abs(new - old) / np.maximum(1.0, np.abs(old))
    equal = (old == new) | (np.isnan(old) & np.isnan(new))
    difference = np.where(equal, 0.0, np.where(np.isnan(difference), np.inf, difference))
    overall = (published.scenario == -1).to_numpy()
    largest, within = int(difference.argmax()), float((difference <= TOLERANCE).mean())
    row = published.iloc[largest]
    location = ", ".join(f"{key} {row[key]}" for key in KEYS)
    text = (
        f"{name}: {len(old)} scores of a new evaluation: largest difference "
        f"{difference[largest]:.2g} ({location}), of scores over all scenarios "
        f"{difference[overall].max():.2g}; {within:.2%} are within {TOLERANCE:g}, "
        f"at least {SHARE:.0%} must be"
    )
    return bool(difference[overall].max() <= TOLERANCE and within >= SHARE), text
