"""Cells and their names."""

import pytest

from study.common.errors import BadInput
from study.config.grid import Cell, cells, select
from study.config.settings import Config, Grid


def test_the_grid_is_the_product_and_the_references() -> None:
    every = cells(Config(grid=Grid(seeds=(0, 1))))
    assert len(every) == len(set(every)) == 2 * 2 * 2 * (4 + 2)
    assert sum(cell.is_reference for cell in every) == 2 * 2 * 2 * 2


def test_a_cell_is_its_path() -> None:
    assert Cell("uav", "high", "full_vae", 3).name == "uav/high/full_vae/seed-3"


@pytest.mark.parametrize(
    ("pattern", "count"),
    [("pusher/high/*", 6), ("*/residual_vae/*", 4), ("uav", 12), ("uav/low/oracle/seed-0", 1)],
)
def test_select(pattern: str, count: int) -> None:
    assert len(select(cells(Config()), pattern)) == count


def test_select_nothing() -> None:
    with pytest.raises(BadInput, match="did you mean 'uav/"):
        select(cells(Config()), "uav/low/oracel/seed-0")
