"""Reading scores: errors of one line, and the order of names."""

from pathlib import Path

import pandas as pd
import pytest

from paper_figs.scores import failed_cells, in_order, read_scores
from study.common.errors import BadInput


@pytest.mark.parametrize("problem", ["no folder", "no file", "no table", "no column"])
def test_unusable_results_are_an_error_of_one_line(tmp_path: Path, problem: str) -> None:
    folder = tmp_path / "none" if problem == "no folder" else tmp_path
    if problem == "no table":
        (folder / "scores.parquet").write_bytes(b"PAR1 and no more")
    if problem == "no column":
        pd.DataFrame({"metric": ["mmd2"]}).to_parquet(folder / "scores.parquet")
    with pytest.raises(BadInput, match=r"run `python -m study\.run all` first") as caught:
        read_scores(folder)
    assert "\n" not in str(caught.value)


def test_failed_cells_are_those_of_the_study(results: Path, tmp_path: Path) -> None:
    assert failed_cells(results) == {("uav", "high", "full_vae")}
    assert failed_cells(tmp_path) == set()


def test_known_names_come_first_and_others_sorted() -> None:
    assert in_order(["b", "uav", "a", "pusher", "b"], ("pusher", "uav", "swarm")) == [
        "pusher",
        "uav",
        "a",
        "b",
    ]
