"""From the cells' artifacts to results/<study>/: scores, claims, tables, figures, recordings.

Everything here is made from the artifacts of the cells that are complete. A cell that failed, or
was not run, is missing from the scores and shown as such in the tables.
"""

import json
import shutil
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from study import __version__
from study.claims import judge as claims
from study.common import trials
from study.common.files import copy, digest, read_json, same_bytes, sha256, write_json, write_text
from study.common.provenance import made_with, versions
from study.config.grid import Cell, among
from study.config.settings import Config
from study.recording.integrity import checksum_path
from study.results import checksums
from study.results.folder import FORMAT, STUDY, settings_of
from study.workflow.store import Store, Task

# Raise it whenever the code changes what the summary holds: then it is written again.
SUMMARY = 4
# What the recording of the whole study shows of the tables and of the claims, by title.
TEXTS = {"Brier scores": "tables/brier_*.md", "Claims": "claims.md", "Scores": "tables/scores_*.md"}
Records = Mapping[Cell, Task]
SCORES, TRIALS, CLAIMS = "scores.parquet", "trials.parquet", "claims.json"
VERDICTS = "claims.md"


@dataclass(frozen=True)
class Whole:
    """A study without its cells' own files.

    Attributes:
        config: its settings.
        complete: the cells that have results, in the order of the grid.
        failed: names of those that have none since a stage failed.
        scores: of the complete cells, to single precision, in their order.
        trials: of their searches for β.
        versions: of the packages that made them.
    """

    config: Config
    complete: Sequence[Cell]
    failed: Sequence[str]
    scores: pd.DataFrame
    trials: pd.DataFrame
    versions: Mapping[str, str]


def publish(config: Config, records: Records, store: Store, out: Path) -> bool:
    """Bring `out` up to date with the cells' artifacts.

    Args:
        config: the study's settings.
        records: the last task of every cell of the grid; cells whose last task is not complete are
            left out.
        store: where the artifacts are.
        out: the results folder.

    Returns:
        whether anything had to be written.
    """
    complete = {cell: task for cell, task in records.items() if store.why_not(task) is None}
    if not complete:
        return False
    files = _cell_files(config, complete, store, out)
    changed = _remove_others(files, out)
    # A recording before its checksum: stopped in between, it is taken for damaged, not for good.
    for target, source in sorted(files.items(), key=lambda pair: len(pair[0].name)):
        if not same_bytes(source, target):
            checksum_path(target).unlink(missing_ok=True)
            copy(source, target)
            changed = True
    failed = _failed(records, store)
    state = _state(config, complete, failed)
    if changed or _why_not_current(out, state):
        scores, tried = _gather(store, complete)
        write_summary(Whole(config, list(complete), failed, scores, tried, versions()), out)
        write_json(_published(out), {"state": state, "files": _summary_files(out)})
        changed = True
    return changed


def why_not_published(
    config: Config, records: Records, store: Store, out: Path, due: Collection[Task]
) -> str | None:
    """Why `publish` would have something to do once the tasks `due` have run; None if not."""
    complete = {
        cell: task for cell, task in records.items() if task in due or store.why_not(task) is None
    }
    failed = [] if due else _failed(records, store)
    why = _why_not_current(out, _state(config, complete, failed))
    if why or due:
        return why or "input changed"
    for target, source in _cell_files(config, complete, store, out).items():
        if not same_bytes(source, target):
            return f"{'damaged' if target.exists() else 'missing'}: {target}"
    return next(iter(checksums.problems(out)), None)


def draw(out: Path) -> list[Path]:
    """Every table and figure, from the results alone."""
    from paper_figs import (
        base_rates,
        beta,
        calibration,
        fig1_trajectories,
        fig3_mmd,
        mmd_by_dimension,
        outcome_tables,
        reliability,
        score_tables,
        tables_1_2_brier,
        variance_ratio,
    )

    scripts = (
        tables_1_2_brier,
        outcome_tables,
        score_tables,
        fig1_trajectories,
        fig3_mmd,
        mmd_by_dimension,
        reliability,
        calibration,
        variance_ratio,
        beta,
        base_rates,
    )
    return [path for script in scripts for path in script.draw(out)]


def judge(scores: pd.DataFrame, out: Path) -> list[Path]:
    """The verdict on every claim, from the scores alone."""
    verdicts = claims.judge(scores)
    write_text(out / CLAIMS, claims.to_json(verdicts))
    write_text(out / VERDICTS, claims.to_markdown(verdicts))
    return [out / CLAIMS, out / VERDICTS]


def _published(out: Path) -> Path:
    """Where the checksums of the summary are kept, and what it was made from."""
    return out / "work" / "published.json"


def _failed(records: Records, store: Store) -> list[str]:
    """Names of the cells that are not complete since one of their stages failed."""

    def fails(task: Task) -> bool:
        if store.why_not(task) is None:
            return False
        return store.failure(task).exists() or any(map(fails, task.inputs.values()))

    return [cell.name for cell, task in records.items() if fails(task)]


def _state(config: Config, complete: Records, failed: list[str]) -> str:
    """What the summary depends on, in one hash."""
    cells = {cell.name: task.key for cell, task in complete.items()}
    return digest([FORMAT, SUMMARY, __version__, settings_of(config), cells, failed])


def _why_not_current(out: Path, state: str) -> str | None:
    """Why the summary has to be written; None if not."""
    try:
        published = read_json(_published(out))
        if published["state"] != state:
            return "input changed"
        for name, expected in published["files"].items():
            if not (out / name).is_file() or sha256(out / name) != expected:
                return f"damaged: {out / name}"
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return "missing"
    return None


def _summary_files(out: Path) -> dict[str, str]:
    """The checksum of every file of the summary."""
    paths = [out / STUDY, out / SCORES, out / TRIALS, out / CLAIMS, out / VERDICTS]
    paths += _whole(out)
    for folder in ("tables", "figures"):
        paths += sorted(path for path in (out / folder).glob("*") if path.is_file())
    return {str(path.relative_to(out)): sha256(path) for path in paths}


def _cell_files(config: Config, complete: Records, store: Store, out: Path) -> dict[Path, Path]:
    """The cells' recordings, weights and illustrations: where each goes, where it comes from."""
    files = {}
    chosen = config.publish
    for cell, task in complete.items():
        for path in store.folder(task).glob("*.rrd*"):
            is_forecast = path.name.startswith("forecast.")
            if among(cell, chosen.forecasts if is_forecast else chosen.recordings):
                files[out / "recordings" / cell.name / path.name] = path
        for path in store.folder(task.inputs["data_recording"]).glob("*.rrd*"):
            files[out / "recordings" / cell.environment / path.name] = path
        if "trained" in task.inputs and among(cell, chosen.weights):
            weights = store.folder(task.inputs["trained"]) / "model.safetensors"
            files[out / "weights" / f"{cell.name}.safetensors"] = weights
        illustration = store.folder(task.inputs["evaluation"]) / "illustration.safetensors"
        if illustration.is_file() and among(cell, chosen.recordings):
            files[out / "illustrations" / f"{cell.name}.safetensors"] = illustration
    return files


def _whole(out: Path) -> tuple[Path, Path]:
    """The recording of the whole study, and its checksum."""
    recording = out / "recordings" / "study.rrd"
    return recording, checksum_path(recording)


def _remove_others(files: Mapping[Path, Path], out: Path) -> bool:
    """Remove what belongs to cells that are no part of these results any more."""
    others = [
        path
        for folder in ("recordings", "weights", "illustrations")
        for path in (out / folder).rglob("*")
        if path.is_file() and path not in files and path not in _whole(out)
    ]
    for path in others:
        path.unlink()
    return bool(others)


def _gather(store: Store, complete: Records) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Scores of all cells, and trials of all their searches."""
    tables = [
        pd.read_parquet(store.folder(task.inputs["evaluation"]) / SCORES).assign(**asdict(cell))
        for cell, task in complete.items()
    ]
    scores = pd.concat(tables, ignore_index=True)
    columns = ["environment", "level", "model", "seed", "metric", "dimension", "step", "scenario"]
    return as_published(scores[[*columns, "value"]]), _trials(store, complete)


def write_summary(whole: Whole, out: Path) -> None:
    """Everything in `out` that is about the whole study; the cells' own files are there already."""
    _write_parquet(whole.scores, out / SCORES)
    _write_parquet(whole.trials, out / TRIALS)
    judge(whole.scores, out)
    write_json(
        out / STUDY,
        {
            "format": FORMAT,
            "study": __version__,
            "settings": settings_of(whole.config),
            "cells": [cell.name for cell in whole.complete],
            "failed": whole.failed,
            "versions": whole.versions,
        },
    )
    for folder in ("tables", "figures"):
        shutil.rmtree(out / folder, ignore_errors=True)
    draw(out)
    _record(whole.config, whole.scores, out)


def _record(config: Config, scores: pd.DataFrame, out: Path) -> None:
    """The recording of the whole study, from what is published by now."""
    from study.recording.study import record_study

    properties = {
        "study": config.name,
        "seeds": ", ".join(map(str, config.grid.seeds)),
        **made_with(),
        "config": json.dumps(settings_of(config), sort_keys=True),
    }
    recording, _ = _whole(out)
    record_study(recording, scores, _texts(out), properties)


def _texts(out: Path) -> dict[str, str]:
    """The tables of all environments and the claims, by title."""
    texts = {
        title: [path.read_text(encoding="utf-8") for path in sorted(out.glob(pattern))]
        for title, pattern in TEXTS.items()
    }
    return {title: "\n\n".join(parts) for title, parts in texts.items() if parts}


def as_published(scores: pd.DataFrame) -> pd.DataFrame:
    """Scores to single precision, as forecasts are: digits beyond it are noise, half of the file.

    They stay double precision numbers, so that nothing is added up in single precision.
    """
    return scores.assign(value=scores.value.astype(np.float32).astype(np.float64))


def _write_parquet(table: pd.DataFrame, path: Path) -> None:
    temporary = path.with_name(f".{path.name}")
    floats = list(table.select_dtypes("float64"))
    others = [name for name in table if name not in floats]
    # Bytes of equal weight side by side: what is zero in every number then takes no room.
    table.to_parquet(
        temporary,
        index=False,
        compression="zstd",
        use_dictionary=others,
        use_byte_stream_split=floats,
    )
    temporary.replace(path)


def _trials(store: Store, complete: Records) -> pd.DataFrame:
    """Every trial of every search for β."""
    rows = []
    for cell, task in complete.items():
        if "tuning" in task.inputs:
            tuning = read_json(store.folder(task.inputs["tuning"]) / "tuning.json")
            rows += [
                asdict(cell)
                | {name: trial[name] for name in ("number", "state", "beta")}
                | {"value": trials.score(trial), "chosen": trial["beta"] == tuning["beta"]}
                for trial in tuning["trials"]
            ]
    columns = ["environment", "level", "model", "seed", "number", "state", "beta", "value"]
    return pd.DataFrame(rows, columns=[*columns, "chosen"])
