"""The scores of a study, and the order of environments, levels and models in figures and tables."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from study.claims.paper import BRIER
from study.common.errors import BadInput
from study.config.names import BEYOND, ENSEMBLE, ENVIRONMENTS, FROM_DATA, LEVELS, MODELS, ORACLE
from study.metrics.tables.table import CELL, COLUMNS


def read_scores(results: Path) -> pd.DataFrame:
    """The scores of all cells of a study.

    Raises:
        BadInput: there is no such folder, or it has no readable table of scores.
    """
    remedy = "run `python -m study.run all` first, or name another folder"
    path = results / "scores.parquet"
    if not results.is_dir():
        raise BadInput(f"there is no folder {results}: {remedy}")
    if not path.is_file():
        raise BadInput(f"{results} holds no scores.parquet: {remedy}")
    try:
        scores = pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise BadInput(f"{path} is not a complete Parquet file ({error}): {remedy}") from error
    missing = [column for column in (*CELL, *COLUMNS) if column not in scores.columns]
    if missing:
        raise BadInput(f"{path} has no column {', '.join(missing)}: {remedy}")
    return scores


def failed_cells(results: Path) -> set[tuple[str, str, str]]:
    """Environment, level and model of the cells that failed, from ``study.json``."""
    try:
        names = json.loads((results / "study.json").read_text(encoding="utf-8"))["failed"]
    except (OSError, ValueError, KeyError):
        return set()
    parts = (name.split("/") for name in names)
    return {(environment, level, model) for environment, level, model, _ in parts}


def rollouts(results: Path, environment: str = "") -> int | None:
    """The number of observed rollouts of each scenario, from ``study.json``; None without it.

    A scenario of a recorded system was observed once.
    """
    try:
        settings = _settings(results)
        return 1 if environment in settings else int(settings["collect"]["rollouts"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def main_outcome(results: Path, environment: str) -> str:
    """The name of the main outcome; a recorded system names its own in ``study.json``."""
    try:
        return str(_settings(results)[environment]["outcomes"][0]).partition(" = ")[0]
    except (OSError, ValueError, KeyError, TypeError, IndexError):
        return "reaches the goal"


def _settings(results: Path) -> dict[str, Any]:
    settings: dict[str, Any] = json.loads((results / "study.json").read_text(encoding="utf-8"))[
        "settings"
    ]
    return settings


def in_order(names: Iterable[str], first: Sequence[str]) -> list[str]:
    """The distinct names: first those in `first`, in its order, then the others, sorted."""
    present = set(names)
    return [name for name in first if name in present] + sorted(present - set(first))


def environments(scores: pd.DataFrame) -> list[str]:
    """The environments with scores, the paper's first."""
    return in_order(scores["environment"].unique(), ENVIRONMENTS)


def levels(scores: pd.DataFrame) -> list[str]:
    """The levels with scores, low first."""
    return in_order(scores["level"].unique(), LEVELS)


def models(scores: pd.DataFrame) -> list[str]:
    """The models with scores, the paper's first."""
    return in_order(scores["model"].unique(), (*MODELS, *BEYOND))


def forecasters(scores: pd.DataFrame, environment: str) -> tuple[list[str], list[str]]:
    """The learned models and the references in the tables of an environment.

    A recorded system has the references from its data in place of the oracle. In the paper's
    environments, the paper's models are included with or without scores.
    """
    has_oracle = not scores["model"].isin(FROM_DATA).any()
    references = [ORACLE, ENSEMBLE] if has_oracle else [*FROM_DATA, ENSEMBLE]
    present = [model for model in models(scores) if model not in references]
    is_of_paper = any(environment == name for name, _, _ in BRIER)
    names = [*MODELS, *present] if is_of_paper else present
    return in_order(names, (*MODELS, *BEYOND)), references
