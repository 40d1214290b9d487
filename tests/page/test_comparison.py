"""Two studies side by side: what differs in settings, scores, verdicts and versions."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from study.common.files import read_json, write_json
from study.config.names import FULL, RESIDUAL
from study.metrics.intervals import difference
from study.metrics.tables.table import select
from study.page import comparison
from study.page.comparison import same_test_set, scores, settings, verdicts, write_comparison
from study.page.evidence import read
from study.page.tables import Table

GAIN = 0.02


@pytest.fixture
def changed(published: Path, tmp_path: Path) -> Path:
    """The same study with another setting and a lower MMD² of one model."""
    folder = Path(shutil.copytree(published, tmp_path / "changed"))
    facts = read_json(folder / "study.json")
    facts["settings"]["train"]["steps"] += 1
    facts["versions"]["torch"] = "9"
    write_json(folder / "study.json", facts)
    table = pd.read_parquet(folder / "scores.parquet")
    better = (table.metric == "mmd2") & (table.model == FULL)
    noise = np.random.default_rng(0).normal(0, 1e-3, better.sum())
    table.loc[better, "value"] += noise - GAIN
    table.to_parquet(folder / "scores.parquet")
    return folder


def texts(table: Table | None) -> list[list[str]]:
    assert table is not None
    return [[value.text for value in row] for row in table.rows]


def change(folder: Path, edit: Callable[[dict[str, Any]], None]) -> Path:
    facts = read_json(folder / "study.json")
    edit(facts["settings"])
    write_json(folder / "study.json", facts)
    return folder


def test_only_the_settings_that_differ(published: Path, changed: Path) -> None:
    ((name, first, second),) = texts(settings(read(published), read(changed)))
    assert name == "train.steps"
    assert int(second) == int(first) + 1
    assert settings(read(published), read(published)).rows == []


def test_differences_are_paired_on_seeds_and_scenarios(published: Path, changed: Path) -> None:
    one, other = read(published), read(changed)
    table, results = scores(one, other, same_test_set(one, other))
    assert table is not None
    rows = {tuple(row[:4]): row for row in table.download[1:]}
    row = rows["pusher", "low", FULL, "mmd2"]
    values = [
        select(e.scores, "mmd2", "pusher", "low", FULL).to_numpy()
        for e in (one, other)
        if e.scores is not None
    ]
    expected = difference(values[1], values[0])
    assert row[6:9] == pytest.approx([expected.estimate, expected.low, expected.high])
    assert row[6] == pytest.approx(-GAIN, abs=1e-3)
    assert row[9:] == [2, 60]
    assert rows["pusher", "low", RESIDUAL, "mmd2"][6] == 0
    assert results.count("lower") == 3, "one cell of the model has failed"
    assert results.count("higher") == 0


def test_other_test_scenarios_are_not_paired(published: Path, changed: Path) -> None:
    change(changed, lambda s: s["collect"].update(seed=s["collect"]["seed"] + 1))
    one, other = read(published), read(changed)
    assert not same_test_set(one, other)
    paired, _ = scores(one, other, True)
    independent, _ = scores(one, other, False)
    assert paired is not None
    assert independent is not None

    def width(table: Table) -> float:
        (row,) = [r for r in table.download[1:] if list(r[:4]) == ["uav", "low", FULL, "mmd2"]]
        return float(row[8] - row[7])

    assert width(independent) > 2 * width(paired)


def test_a_cell_of_one_study_alone_has_no_difference(published: Path, changed: Path) -> None:
    table = pd.read_parquet(changed / "scores.parquet")
    table[table.model != RESIDUAL].to_parquet(changed / "scores.parquet")
    found, _ = scores(read(published), read(changed), True)
    rows = [row for row in texts(found) if row[2] == "residual VAE" and row[3] == "MMD²"]
    assert len(rows) == 4
    assert all(row[5:] == ["—", "—", "—"] for row in rows)


def test_verdicts_that_differ_are_marked(published: Path, changed: Path) -> None:
    claims = read_json(changed / "claims.json")
    before = claims[0]["verdict"]
    claims[0]["verdict"] = "inconclusive"
    write_json(changed / "claims.json", claims[:-1])
    rows = texts(verdicts(read(published), read(changed)))
    assert rows[0][1:] == [before, "inconclusive", "differs"]
    assert rows[1][3] == "same"
    assert rows[-1][2:] == ["—", "differs"]


def test_the_page_is_in_the_second_folder_and_escaped(published: Path, changed: Path) -> None:
    change(changed, lambda s: s.update(name="<b>mine</b>"))
    path = write_comparison(published, changed)
    assert path == changed / f"against_{published.name}.html"
    text = path.read_text(encoding="utf-8")
    assert "<b>mine</b>" not in text
    assert "paired on scenarios and seeds" in text
    assert "versions: torch" in text
    assert not (published / path.name).exists()
    assert comparison.TEST_SET
