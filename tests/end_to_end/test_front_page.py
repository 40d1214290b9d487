"""The numbers on the front page are those of results/paper/, which are as they were written."""

import re
from functools import cache
from pathlib import Path

import pandas as pd
import pytest

from study.claims.paper import BRIER
from study.common.files import read_json
from study.config.names import LABELS
from study.models.checkpoints import load_model
from study.results import checksums, folder

ROOT = Path(__file__).parents[2]
PAPER = ROOT / "results" / "paper"
SECTION = (ROOT / "README.md").read_text().split("## Does it reproduce?")[1].split("\n### ")[0]
MODELS = {name: model for model, name in LABELS.items()}


def _tables() -> list[dict[tuple[str, str], str]]:
    """Each table's entries, by row and column."""
    tables = []
    for text in re.findall(r"(?:^\|.*\n)+", SECTION, re.MULTILINE):
        header, _, *rows = (
            [cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()
        )
        tables.append(
            {
                (row[0], column): cell
                for row in rows
                for column, cell in zip(header, row, strict=True)
            }
        )
    return tables


@cache
def _scores() -> pd.DataFrame:
    scores = pd.read_parquet(PAPER / "scores.parquet")
    return scores[(scores.step == -1) & (scores.scenario == -1) & (scores.dimension == "all")]


def _overall(metric: str, environment: str, level: str, model: str) -> float:
    here = _scores()
    here = here[(here.metric == metric) & (here.environment == environment)]
    if model != "climatology":
        here = here[(here.level == level) & (here.model == model)]
    return float(here.value.mean())


@pytest.mark.parametrize(("table", "metric"), [(0, "brier"), (1, "mmd2")])
def test_the_tables(table: int, metric: str) -> None:
    entries = {key: cell for key, cell in _tables()[table].items() if key[1]}
    assert len(entries) == 4 * (8 if metric == "brier" else 7)
    for (row, column), cell in entries.items():
        environment, level = (MODELS[name] for name in row.split(", "))
        model = MODELS.get(column, column)
        name = "brier_climatology" if model == "climatology" else metric
        told = re.match(r"\**(-?[\d.]+)\**(?: \(([\d.]+)\))?$", cell)
        assert told, cell
        value = _overall(name, environment, level, model)
        assert abs(float(told[1]) - value) <= 0.00051, (row, column)
        paper = BRIER.get((environment, level, model)) if metric == "brier" else None
        assert (told[2] and float(told[2])) == paper
        rivals = [
            _overall(metric, environment, level, m)
            for m in ("residual_vae", "full_vae", "probabilistic_mlp")
        ]
        assert cell.startswith("**") == (model in MODELS.values() and value == min(rivals))


def test_the_count_of_claims() -> None:
    told = re.search(
        r"(\d+) claims (\d+) were reproduced, (\d+) partly and (\d+) not",
        SECTION.replace("\n", " "),
    )
    assert told
    verdicts = [c["verdict"] for c in read_json(PAPER / "claims.json") if c["section"] != "ours"]
    counts = [verdicts.count(v) for v in ("reproduced", "partly", "not reproduced")]
    assert list(map(int, told.groups())) == [len(verdicts), *counts]


def test_what_is_shipped_can_be_used() -> None:
    """Its settings are known, and every model that is there can be loaded."""
    study = folder.read(PAPER)
    shipped = [cell for cell in study.complete if study.ships(cell)]
    assert shipped
    for cell in shipped:
        assert load_model(study.weights(cell)).state_size in (12, 17)


def test_what_is_shipped_is_as_it_was_written_and_small() -> None:
    assert not list(checksums.problems(PAPER))
    assert (
        sum(
            path.stat().st_size
            for path in (ROOT / "results" / "paper").rglob("*")
            if path.is_file()
        )
        < 60e6
    )
