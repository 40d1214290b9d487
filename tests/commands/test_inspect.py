"""Command `inspect`: what it sees in logs, and what it refuses."""

from pathlib import Path

import numpy as np
import pytest

from study.common.errors import BadInput
from study.config import strict_yaml
from tests.helpers.logs import log, write
from tests.helpers.running import study


@pytest.fixture(autouse=True)
def _inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def section(text: str) -> dict[str, object]:
    """The section of the logs in the configuration that `inspect` prints."""
    content = strict_yaml.parse(text[text.index("# Written by") :])
    found = content["my_robot"]
    assert isinstance(found, dict)
    return found


def test_text_in_numbers_is_told_from_values_that_are_not_finite(tmp_path: Path) -> None:
    frame = log().astype(object)
    frame.loc[7, "x"] = "abc"
    frame.loc[[3, 4], "v"] = np.nan
    frame.to_csv(tmp_path / "log.csv", index=False)
    done = study("inspect", "log.csv")
    assert "CHECK: text in 1 row, such as 'abc'" in done.out
    assert "2 not finite" in done.out
    assert "1 not finite" not in done.out
    assert "1 log, 40 rows in 1 table" in done.out


def test_files_that_lack_a_column_are_named(tmp_path: Path) -> None:
    write(tmp_path)
    log(seed=3).drop(columns=["t", "v"]).to_csv(tmp_path / "3.csv", index=False)
    out = study("inspect", "*.csv").out
    assert "1 of 6 files lack column 'v': 3.csv" in out
    assert "1 of 6 files lack column 't': 3.csv" in out


def test_angles_beyond_20_are_proposed_in_degrees(tmp_path: Path) -> None:
    log().assign(yaw=np.linspace(-170, 170, 40)).to_csv(tmp_path / "log.csv", index=False)
    settings = section(study("inspect", "log.csv").out)
    assert settings["state"] == ["x", "v", "yaw [deg]"]
    assert settings["angles"] == ["yaw"]


def test_the_examples_have_the_variables_of_the_logs(tmp_path: Path) -> None:
    log().rename(columns={"x": "joint", "v": "rate"}).to_csv(tmp_path / "log.csv", index=False)
    out = study("inspect", "log.csv").out
    assert "# position: [joint, rate]" in out
    assert "joint is large = joint > " in out


def test_a_pattern_that_is_given_twice_is_written_once(tmp_path: Path) -> None:
    write(tmp_path, count=3)
    assert section(study("inspect", "*.csv", "*.csv").out)["files"] == ["*.csv"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nothing.csv"], "no file matches"),
        (["folder"], "no LeRobot or Minari data set"),
        (["0.csv", "--horizon=1"], "give at least 2 steps"),
        (["0.csv", "--write=no/such/bot.yaml"], "the folder 'no/such' does not exist"),
        (["0.csv", "--write=bot.txt"], "must be a .yaml file"),
    ],
)
def test_what_is_refused(tmp_path: Path, arguments: list[str], message: str) -> None:
    write(tmp_path, count=1)
    (tmp_path / "folder").mkdir()
    done = study("inspect", *arguments)
    assert done.code == BadInput.exit_code
    assert message in done.err
    assert not (tmp_path / "no").exists()
