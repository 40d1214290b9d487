"""Reliability diagrams: their files, colours, and results without outcomes."""

from pathlib import Path

import pandas as pd
import pytest

from paper_figs import reliability
from study.plotting import style
from tests.paper_figs.known_scores import FORECASTERS
from tests.paper_figs.pictures import pixels_of, size_of


@pytest.fixture(scope="module")
def figures(outcome_results: Path) -> list[Path]:
    return reliability.plot(outcome_results)


def test_its_files(figures: list[Path]) -> None:
    assert [path.name for path in figures] == ["reliability_uav.png", "reliability_uav.pdf"]
    assert size_of(figures[0])[0] == pytest.approx(300 * style.COLUMN_WIDTH, abs=2)
    assert b"/Type3" not in figures[1].read_bytes()


@pytest.mark.parametrize("model", FORECASTERS)
def test_every_model_is_visible(figures: list[Path], model: str) -> None:
    assert pixels_of(figures[0], style.COLOURS[model]) > 500


def test_the_same_scores_give_the_same_bytes(outcome_results: Path, figures: list[Path]) -> None:
    first = [path.read_bytes() for path in figures]
    assert [path.read_bytes() for path in reliability.plot(outcome_results)] == first


def test_one_level_and_seed_of_a_new_environment(goal_results: Path) -> None:
    names = [path.name for path in reliability.plot(goal_results)]
    assert names == ["reliability_toy.png", "reliability_toy.pdf"]


def test_scores_without_outcomes_have_no_figure(
    outcome_scores: pd.DataFrame, tmp_path: Path
) -> None:
    outcome_scores.assign(metric="mmd2").to_parquet(tmp_path / "scores.parquet")
    assert reliability.plot(tmp_path) == []
