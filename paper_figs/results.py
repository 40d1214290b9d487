"""What the scripts of this folder share: reading the scores of a study, and a command line."""

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import pandas as pd

from study.claims.paper import BRIER
from study.common.errors import BadInput, StudyError
from study.config.names import BEYOND, ENSEMBLE, ENVIRONMENTS, LEVELS, MODELS, ORACLE
from study.metrics.tables.table import CELL, COLUMNS


def read_scores(results: Path) -> pd.DataFrame:
    """The scores of all cells of a study.

    Raises:
        BadInput: there is no such folder, or no table of scores in it that can be read.
    """
    remedy = "run `python -m study.run all` first, or give another folder"
    path = results / "scores.parquet"
    if not results.is_dir():
        raise BadInput(f"there is no folder {results}: {remedy}")
    if not path.is_file():
        raise BadInput(f"{results} holds no scores.parquet: {remedy}")
    try:
        scores = pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise BadInput(f"{path} is not a whole Parquet file ({error}): {remedy}") from error
    absent = [column for column in (*CELL, *COLUMNS) if column not in scores.columns]
    if absent:
        raise BadInput(f"{path} has no column {', '.join(absent)}: {remedy}")
    return scores


def failed_cells(results: Path) -> set[tuple[str, str, str]]:
    """Environment, level and model of the cells that failed, by ``study.json``."""
    try:
        names = json.loads((results / "study.json").read_text(encoding="utf-8"))["failed"]
    except (OSError, ValueError, KeyError):
        return set()
    parts = (name.split("/") for name in names)
    return {(environment, level, model) for environment, level, model, _ in parts}


def in_order(names: Iterable[str], first: Sequence[str]) -> list[str]:
    """The names, without repetition: those of `first` in its order, then the others sorted."""
    present = set(names)
    return [name for name in first if name in present] + sorted(present - set(first))


def environments(scores: pd.DataFrame) -> list[str]:
    """The environments that have scores, the paper's first."""
    return in_order(scores["environment"].unique(), ENVIRONMENTS)


def levels(scores: pd.DataFrame) -> list[str]:
    """The levels that have scores, low first."""
    return in_order(scores["level"].unique(), LEVELS)


def models(scores: pd.DataFrame) -> list[str]:
    """The models that have scores, the paper's first."""
    return in_order(scores["model"].unique(), (*MODELS, *BEYOND))


def forecasters(scores: pd.DataFrame, environment: str) -> tuple[list[str], list[str]]:
    """The learned models and the references that a table of an environment shows.

    The paper's models are there with or without scores, if the environment is the paper's.
    """
    references = [ORACLE, ENSEMBLE]
    present = [model for model in models(scores) if model not in references]
    of_paper = any(environment == known for known, _, _ in BRIER)
    return in_order([*MODELS, *present] if of_paper else present, (*MODELS, *BEYOND)), references


def command(
    draw: Callable[[Path], list[Path]], about: str, arguments: Sequence[str] | None = None
) -> int:
    """The command line of a script: draw from `--results`, print what was written.

    `arguments` are those of the process if None.

    Returns the exit code: 2, after one line on standard error, if there is nothing to draw from.
    """
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--results", type=Path, required=True, help="folder of a study's results")
    try:
        for path in draw(parser.parse_args(arguments).results):
            print(path)
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0
