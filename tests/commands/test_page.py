"""Command `page`: the page of a study, and of two."""

from pathlib import Path

import pandas as pd
import pytest

from tests.helpers.running import study
from tests.helpers.synthetic import scores


def folder(path: Path) -> Path:
    path.mkdir()
    table: pd.DataFrame = scores(seeds=1)
    table[table.environment == "uav"].to_parquet(path / "scores.parquet")
    return path


def test_one_folder_and_two(tmp_path: Path) -> None:
    one, other = folder(tmp_path / "one"), folder(tmp_path / "other")
    done = study("page", one)
    assert (done.code, done.out.split()) == (0, [str(one / "index.html")])
    done = study("page", one, other)
    assert (done.code, done.out.split()) == (0, [str(other / "against_one.html")])
    assert sorted(path.name for path in other.iterdir()) == ["against_one.html", "scores.parquet"]


def test_a_folder_without_results(tmp_path: Path) -> None:
    for arguments in ([tmp_path], [folder(tmp_path / "one"), tmp_path], [tmp_path / "none"]):
        done = study("page", *arguments)
        assert done.code == 2
        assert done.err.startswith("error: ")
        assert done.err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["one"]


def test_a_folder_is_not_compared_with_itself(tmp_path: Path) -> None:
    one = folder(tmp_path / "one")
    done = study("page", one, tmp_path / "one" / ".." / "one")
    assert done.code == 2
    assert "are one folder; give two folders" in done.err
    assert [path.name for path in one.iterdir()] == ["scores.parquet"]


@pytest.mark.parametrize("command", ["serve", "catalog"])
def test_a_port_is_a_number(command: str, tmp_path: Path) -> None:
    done = study(command, "--out", tmp_path, "--port", "x")
    assert done.code == 2
    assert done.err == "error: --port: got 'x'; it must be a whole number\n"


def test_serve_refuses_a_folder_without_results(tmp_path: Path) -> None:
    done = study("serve", "--out", tmp_path)
    assert done.code == 2
    assert "has no results" in done.err
