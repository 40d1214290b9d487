"""The main numbers of each cell."""

from pathlib import Path

import pytest

from study.results.cell_scores import cell_scores
from study.results.summary import fits_table
from tests.helpers.synthetic import scores

CELL = "uav/low/residual_vae/seed-1"


def test_means_over_scenarios_and_beta(tmp_path: Path) -> None:
    table = scores(seeds=2)
    table.to_parquet(tmp_path / "scores.parquet")
    cell = {"environment": "uav", "level": "low", "model": "residual_vae", "seed": 1}
    fits_table([cell | {"beta": 10.0}]).to_parquet(tmp_path / "fits.parquet")
    found = cell_scores(tmp_path)
    rows = table[(table[list(cell)] == list(cell.values())).all(axis=1)]
    rows = rows[(rows.metric == "brier") & (rows.scenario >= 0) & (rows.dimension == "all")]
    assert found[CELL]["brier"] == pytest.approx(rows["value"].mean())
    assert found[CELL]["beta"] == 10.0
    assert set(found[CELL]) == {"mmd2", "brier", "beta"}
    assert "beta" not in found["uav/low/residual_vae/seed-0"]


def test_without_readable_files_there_are_no_numbers(tmp_path: Path) -> None:
    assert cell_scores(tmp_path) == {}
    (tmp_path / "scores.parquet").write_bytes(b"PAR1")
    assert cell_scores(tmp_path) == {}
    scores(seeds=1).to_parquet(tmp_path / "scores.parquet")
    (tmp_path / "fits.parquet").write_bytes(b"PAR1")
    assert "beta" not in cell_scores(tmp_path)[CELL.replace("seed-1", "seed-0")]
