"""Results folders for pages, with known scores."""

import json
import shutil
from pathlib import Path

import pandas as pd
import pytest

from study.common.files import write_json
from study.config.names import FULL
from study.config.settings import Config
from study.recording.tuning import record_tuning
from study.results import checksums, summary
from study.results.folder import FORMAT, settings_of
from tests.helpers import recordings
from tests.helpers.synthetic import scores

FAILED = f"uav/high/{FULL}/seed-1"


def write_study(folder: Path, table: pd.DataFrame, name: str = "known") -> Path:
    """A results folder with these scores, and all other files that follow from them."""
    settings = settings_of(Config())
    cells = table[["environment", "level", "model", "seed"]].drop_duplicates()
    names = [f"{r.environment}/{r.level}/{r.model}/seed-{r.seed}" for r in cells.itertuples()]
    write_json(
        folder / "study.json",
        {
            "format": FORMAT,
            "settings": json.loads(json.dumps(settings)) | {"name": name},
            "cells": names,
            "failed": [FAILED],
            "versions": {"python": "3.11"},
            "device": "a machine",
        },
    )
    table.to_parquet(folder / "scores.parquet")
    summary.write_claims(table, folder)
    trials = pd.DataFrame(
        {
            "environment": "uav",
            "level": "low",
            "model": FULL,
            "seed": 0,
            "number": [0, 1, 2],
            "state": ["complete", "complete", "pruned"],
            "beta": [1.0, 10.0, 100.0],
            "value": [0.2, 0.1, 0.3],
            "chosen": [False, True, False],
        }
    )
    trials.to_parquet(folder / "trials.parquet")
    cell = {"environment": "uav", "level": "low", "model": FULL, "seed": 0}
    summary.fits_table([cell | {"beta": 10.0}]).to_parquet(folder / "fits.parquet")
    cost = {f"train uav/low/{FULL}/seed-0": 12.0, "collect uav": 3.0}
    write_json(
        folder / "timings.json",
        {"cpu_seconds": cost, "seconds": cost, "peak_memory": cost, "workers": 2},
    )
    recording = folder / "recordings" / "uav" / "low" / FULL / "seed-0" / "tuning.rrd"
    recording.parent.mkdir(parents=True)
    record_tuning(recording, recordings.trials(), {})
    checksums.write(folder)
    return folder


@pytest.fixture(scope="session")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of the paper's grid with known scores, of which one cell failed."""
    table = scores(seeds=2)
    failed = (table.environment == "uav") & (table.model == FULL) & (table.level == "high")
    return write_study(tmp_path_factory.mktemp("page") / "known", table[~failed])


@pytest.fixture
def copy(published: Path, tmp_path: Path) -> Path:
    """A copy of the study, to be changed or damaged."""
    return Path(shutil.copytree(published, tmp_path / "copy"))
