"""Trajectories of logs: where they begin and end, how they are resampled, and what is refused."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from study.common.errors import BadInput
from tests.helpers.logs import STEP, log, pieces


def written(folder: Path, frame: pd.DataFrame) -> Path:
    path = folder / "log.csv"
    frame.to_csv(path, index=False)
    return path


def test_a_log_is_one_trajectory_with_the_numbers_of_the_file(tmp_path: Path) -> None:
    frame = log()
    (piece,) = pieces(written(tmp_path, frame))
    np.testing.assert_array_equal(piece.states, frame[["x", "v"]].to_numpy(np.float32))
    np.testing.assert_array_equal(piece.actions, frame[["u"]].to_numpy(np.float32))


def test_a_reset_begins_a_trajectory_and_its_last_action_may_be_missing(tmp_path: Path) -> None:
    frame = log().assign(reset=0)
    frame.loc[[0, 15], "reset"] = 1
    frame.loc[14, "u"] = np.nan
    found = pieces(written(tmp_path, frame), reset="reset")
    assert [len(piece) for piece in found] == [15, 25]
    assert len({piece.trajectory for piece in found}) == 2


def test_a_column_names_trajectories(tmp_path: Path) -> None:
    frame = log().assign(run=["a"] * 10 + ["b"] * 30)
    found = pieces(written(tmp_path, frame), trajectory="run")
    assert [piece.trajectory.partition("#")[2] for piece in found] == ["a", "b"]


def test_a_gap_splits_and_both_parts_are_of_one_trajectory(tmp_path: Path) -> None:
    frame = log()
    frame.loc[20:, "t"] += 3.0
    found = pieces(written(tmp_path, frame), breaks="split")
    assert [len(piece) for piece in found] == [20, 20]
    assert len({piece.trajectory for piece in found}) == 1


def test_rows_that_are_not_finite_or_excluded_split(tmp_path: Path) -> None:
    frame = log()
    frame.loc[10, "x"] = np.inf
    frame.loc[30, "u"] = 99.0
    found = pieces(written(tmp_path, frame), breaks="split", exclude=("u > 50",))
    assert [len(piece) for piece in found] == [10, 19, 9]


def test_resampling_interpolates_states_and_averages_actions(tmp_path: Path) -> None:
    frame = log()
    (piece,) = pieces(written(tmp_path, frame), control_step=2 * STEP)
    np.testing.assert_allclose(piece.states[:, 0], frame["x"][::2], atol=1e-6)
    expected = (frame["u"].to_numpy()[:-2:2] + frame["u"].to_numpy()[1:-2:2]) / 2
    np.testing.assert_allclose(piece.actions[: len(expected), 0], expected, atol=1e-6)


def test_an_angle_is_unwrapped_before_it_is_interpolated(tmp_path: Path) -> None:
    turning = 0.9 * np.arange(40)
    frame = log().assign(x=np.angle(np.exp(1j * turning)))
    (piece,) = pieces(written(tmp_path, frame), control_step=STEP / 2, angles=("x",))
    np.testing.assert_allclose(np.diff(piece.states[:, 0]), 0.45, atol=1e-5)
    (piece,) = pieces(written(tmp_path, frame), angles=("x",), angles_as="sine_cosine")
    np.testing.assert_allclose(piece.states[:, 0], np.sin(turning), atol=1e-6)
    np.testing.assert_allclose(piece.states[:, 1], np.cos(turning), atol=1e-6)


def test_an_angle_in_degrees_becomes_rad(tmp_path: Path) -> None:
    turning = 0.9 * np.arange(40)
    frame = log().assign(x=np.degrees(np.angle(np.exp(1j * turning))))
    (piece,) = pieces(written(tmp_path, frame), state=("x [deg]", "v"), angles=("x",))
    np.testing.assert_allclose(piece.states[:, 0], turning, atol=1e-5)


def test_a_control_step_far_below_the_interval_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"cart\.control_step: got 1e-09; .* 40 rows in 3\.9 s"):
        pieces(written(tmp_path, log()), control_step=1e-9)


def test_a_long_trajectory_is_cut_into_trajectories_without_common_rows(tmp_path: Path) -> None:
    found = pieces(written(tmp_path, log()), longest_trajectory=1.0)
    assert [len(piece) for piece in found] == [11, 11, 11, 7]
    assert len({piece.trajectory for piece in found}) == 4
    times = np.concatenate([piece.states[:, 0] for piece in found])
    np.testing.assert_array_equal(times, log()["x"].to_numpy(np.float32))


def text(frame: pd.DataFrame) -> pd.DataFrame:
    frame = frame.astype(object)
    frame.loc[7, "x"] = "abc"
    return frame


def backwards(frame: pd.DataFrame) -> pd.DataFrame:
    frame.loc[20, "t"] = 0.3
    return frame


def jump(frame: pd.DataFrame) -> pd.DataFrame:
    frame.loc[20:, "t"] += 3.0
    return frame


def late(frame: pd.DataFrame) -> pd.DataFrame:
    frame.loc[20:, "t"] += STEP / 2
    return frame


def huge(frame: pd.DataFrame) -> pd.DataFrame:
    frame.loc[7, "x"] = 1e300  # overflows to infinity in 32 bits
    return frame


def not_finite(frame: pd.DataFrame) -> pd.DataFrame:
    frame.loc[[7, 9], "x"] = np.nan
    return frame


@pytest.mark.parametrize(
    ("change", "messages"),
    [
        (lambda frame: frame.drop(columns="v"), ["no column 'v'", "cart.state"]),
        (text, ["column 'x', line 9", "'abc'", "1 of 40 rows"]),
        (huge, ["column 'x', line 9", "1e+300", "32-bit"]),
        (not_finite, ["column 'x', line 9", "2 of 40 rows"]),
        (backwards, ["column 't', line 22", "from 1.9 s to 0.3 s"]),
        (jump, ["column 't', line 22", "jumps by 3.1 s"]),
        (late, ["column 't', line 22", "control_step"]),
    ],
)
def test_an_error_names_file_column_and_row(
    tmp_path: Path, change: Callable[[pd.DataFrame], pd.DataFrame], messages: list[str]
) -> None:
    path = written(tmp_path, change(log()))
    with pytest.raises(BadInput) as caught:
        pieces(path)
    for message in (str(path), *messages):
        assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_the_time_of_the_log_leaves_out_its_end(tmp_path: Path) -> None:
    frame = log()
    frame["t"] += 100.0
    (piece,) = pieces(written(tmp_path, frame), exclude=("t > 1.95",))
    assert len(piece) == 20


def test_the_time_may_be_dates_or_in_another_unit(tmp_path: Path) -> None:
    frame = log()
    dates = pd.Timestamp("2026-01-02 03:04:05") + pd.to_timedelta(frame["t"], unit="s")
    for column, unit in ((dates, "s"), (1e9 * frame["t"], "ns"), (1e3 * frame["t"], "ms")):
        path = written(tmp_path, frame.assign(t=column))
        (piece,) = pieces(path, control_step=2 * STEP, time_unit=unit)
        np.testing.assert_allclose(piece.states[:, 0], frame["x"][::2], atol=1e-6)
