"""From the cells' artifacts to results/<study>/: scores, claims, tables, figures, recordings.

Everything here is made from the artifacts of the cells that are complete. A cell that failed, or
was not run, is missing from the scores and shown as such in the tables.
"""

import platform
import shutil
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from study import __version__, claims
from study.artifacts import Store, Task
from study.config import Config
from study.files import copy, digest, read_json, same_bytes, sha256, write_json, write_text
from study.grid import Cell
from study.pipeline import Pipeline
from study.recording.files import checksum_path

# A results folder of another format is not touched.
FORMAT = 1
PACKAGES = ("torch", "lightning", "mujoco", "rerun-sdk", "optuna", "numpy", "scoringrules")
SCORES, CLAIMS, STUDY = "scores.parquet", "claims.json", "study.json"


def publish(config: Config, cells: list[Cell], store: Store, out: Path) -> bool:
    """Bring `out` up to date with the cells' artifacts.

    Args:
        config: the study's settings.
        cells: every cell of the grid; those whose record stage is not complete are left out.
        store: where the artifacts are.
        out: the results folder.

    Returns:
        whether anything had to be written.
    """
    pipeline = Pipeline(config)
    complete = {cell: task for cell in cells if _is_complete(store, task := pipeline.record(cell))}
    changed = False
    for cell, task in complete.items():
        changed |= _publish_cell(pipeline, store, cell, task, out)
    state = _state(config, complete)
    if changed or not _is_current(out, state):
        _write_summary(config, pipeline, store, list(complete), out)
        write_json(out / "work" / "published.json", {"state": state, "files": _files(out)})
        changed = True
    return changed


def why_not_published(config: Config, cells: list[Cell], store: Store, out: Path) -> str | None:
    """Why `publish` would have something to do; None if not."""
    pipeline = Pipeline(config)
    complete = {cell: pipeline.record(cell) for cell in cells}
    try:
        published = read_json(out / "work" / "published.json")
    except (OSError, ValueError):
        return "missing"
    if published.get("state") != _state(config, complete):
        return "input changed"
    for name, expected in published.get("files", {}).items():
        if not (out / name).is_file() or sha256(out / name) != expected:
            return f"damaged: {out / name}"
    return None


def draw(out: Path) -> list[Path]:
    """Every table and figure, from the results alone."""
    from paper_figs import brier_tables, mmd_curves

    return [path for script in (brier_tables, mmd_curves) for path in script.draw(out)]


def _is_complete(store: Store, task: Task) -> bool:
    return store.why_not(task) is None


def _state(config: Config, complete: Mapping[Cell, Task]) -> str:
    """What the summary depends on, in one hash."""
    cells = {cell.name: task.key for cell, task in complete.items()}
    return digest([FORMAT, __version__, _settings(config), cells])


def _is_current(out: Path, state: str) -> bool:
    try:
        published = read_json(out / "work" / "published.json")
        return published["state"] == state and all(
            (out / name).is_file() and sha256(out / name) == expected
            for name, expected in published["files"].items()
        )
    except (OSError, ValueError, KeyError):
        return False


def _files(out: Path) -> dict[str, str]:
    """The checksum of every file of the summary (recordings have their own)."""
    paths = [out / STUDY, out / SCORES, out / CLAIMS, out / "claims.md"]
    for folder in ("tables", "figures"):
        paths += sorted(path for path in (out / folder).glob("*") if path.is_file())
    return {str(path.relative_to(out)): sha256(path) for path in paths}


def _publish_cell(pipeline: Pipeline, store: Store, cell: Cell, task: Task, out: Path) -> bool:
    """Copy the cell's recordings and weights, where they differ."""
    sources = {
        out / "recordings" / cell.name / path.name: path
        for path in store.folder(task).glob("*.rrd*")
    }
    if not cell.is_reference:
        weights = store.folder(pipeline.train(cell)) / "model.safetensors"
        sources[out / "weights" / f"{cell.name}.safetensors"] = weights
    changed = False
    # A recording before its checksum: interrupted in between, it is taken for damaged, not for good.
    for target, source in sorted(sources.items(), key=lambda pair: len(pair[0].name)):
        if not same_bytes(source, target):
            checksum_path(target).unlink(missing_ok=True)
            copy(source, target)
            changed = True
    return changed


def _write_summary(
    config: Config, pipeline: Pipeline, store: Store, complete: list[Cell], out: Path
) -> None:
    tables = [
        pd.read_parquet(store.folder(pipeline.evaluate(cell)) / SCORES).assign(**asdict(cell))
        for cell in complete
    ]
    scores = pd.concat(tables, ignore_index=True)
    columns = ["environment", "level", "model", "seed", "metric", "dimension", "step", "scenario"]
    scores = scores[[*columns, "value"]]
    temporary = out / f".{SCORES}"
    scores.to_parquet(temporary, index=False, compression="zstd")
    temporary.replace(out / SCORES)
    verdicts = claims.judge(scores)
    write_text(out / CLAIMS, claims.to_json(verdicts))
    write_text(out / "claims.md", claims.to_markdown(verdicts))
    write_json(
        out / STUDY,
        {
            "format": FORMAT,
            "study": __version__,
            "settings": _settings(config),
            "cells": [cell.name for cell in complete],
            "versions": {"python": platform.python_version()} | _versions(),
        },
    )
    for folder in ("tables", "figures"):
        shutil.rmtree(out / folder, ignore_errors=True)
    draw(out)


def _versions() -> dict[str, str]:
    versions = {}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except ImportError:
            continue
    return versions


def _settings(config: Config) -> dict[str, Any]:
    """All settings but where the stages ran: no number depends on that."""
    settings = asdict(config)
    settings.pop("engine")
    return settings
