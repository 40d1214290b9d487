"""Windows and their split: no trajectory is on two sides, and no window leaves its piece."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from study.common.errors import BadInput
from study.common.progress import Progress
from study.data.recorded.description import Description
from study.data.recorded.windows import SIDES, Split, read_windows, warnings_of
from tests.helpers.logs import SETTINGS, log, write


def split_of(files: tuple[str, ...], seed: int = 0, **changes: object) -> Split:
    settings = replace(SETTINGS, files=files, **changes)  # type: ignore[arg-type]
    return read_windows(Description("cart", settings), 10, seed, {}, Progress())


def test_a_trajectory_is_on_one_side_alone(tmp_path: Path) -> None:
    split = split_of(write(tmp_path, count=10), test=0.3, validation=0.2)
    names = [set(split.windows[side].trajectories) for side in SIDES]
    assert [len(part) for part in names] == [5, 2, 3]
    assert len(set.union(*names)) == 10


def test_windows_have_the_rows_of_their_log(tmp_path: Path) -> None:
    split = split_of(write(tmp_path))
    train = split.windows["train"]
    states = np.concatenate([part[0] for part in train.parts()])
    actions = np.concatenate([part[1] for part in train.parts()])
    (first, count), *_ = train.trajectories.items()
    frame = log(seed=int(Path(first).stem))
    assert count == 6  # windows of 11 rows that begin every 5 of 40 rows
    for number in range(count):
        rows = frame.iloc[5 * number : 5 * number + 11]
        np.testing.assert_array_equal(states[number], rows[["x", "v"]].to_numpy(np.float32))
        np.testing.assert_array_equal(actions[number], rows[["u"]][:-1].to_numpy(np.float32))


def test_test_windows_do_not_overlap_by_default(tmp_path: Path) -> None:
    test = split_of(write(tmp_path)).windows["test"]
    assert set(np.diff(test.index[:, 1])) == {10}


def test_the_split_depends_on_the_seed_and_on_nothing_else(tmp_path: Path) -> None:
    files = write(tmp_path, count=10)
    first, again, other = (
        list(split_of(files, seed).windows["test"].trajectories) for seed in (0, 0, 1)
    )
    assert first == again
    assert first != other


def test_angles_begin_within_half_a_turn(tmp_path: Path) -> None:
    for number in range(4):
        turning = 0.5 * np.arange(40) + number
        log(seed=number).assign(x=turning).to_csv(tmp_path / f"{number}.csv", index=False)
    split = split_of((str(tmp_path / "*.csv"),), angles=("x",))
    for states, _, _ in split.windows["train"].parts():
        assert np.abs(states[:, 0, 0]).max() <= np.pi + 1e-5
        np.testing.assert_allclose(np.diff(states[..., 0], axis=1), 0.5, atol=1e-5)


def test_copies_of_a_trajectory_are_refused(tmp_path: Path) -> None:
    files = write(tmp_path)
    log(seed=2).to_parquet(tmp_path / "copy.parquet")
    with pytest.raises(BadInput, match=r"copy\.parquet: it has the same numbers as .*2\.csv"):
        split_of((*files, str(tmp_path / "copy.parquet")))


def test_a_copy_of_the_beginning_of_a_trajectory_is_refused(tmp_path: Path) -> None:
    files = write(tmp_path)
    log(seed=2)[:30].to_csv(tmp_path / "part.csv", index=False)
    with pytest.raises(BadInput, match=r"part\.csv: .* as .*2\.csv in their first 30 rows"):
        split_of((*files, str(tmp_path / "part.csv")))


def test_exclusions_that_leave_no_row_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"no row .*cart\.exclude"):
        split_of(write(tmp_path), exclude=("x < 1e9",))


def test_too_few_windows_name_the_horizon(tmp_path: Path) -> None:
    files = write(tmp_path, rows=8)
    with pytest.raises(BadInput, match=r"0 of 6 .* 10 steps .*the longest has 8"):
        split_of(files)
    shutil.rmtree(tmp_path)
    tmp_path.mkdir()
    with pytest.raises(BadInput, match="a split needs three"):
        split_of(write(tmp_path, count=2))


def test_degrees_in_a_column_of_radians_are_warned_of(tmp_path: Path) -> None:
    for number in range(4):
        log(seed=number).assign(x=np.linspace(150, 170, 40)).to_csv(
            tmp_path / f"{number}.csv", index=False
        )
    files = (str(tmp_path / "*.csv"),)
    settings = replace(SETTINGS, files=files, state=("x [rad]", "v"))
    system = Description("cart", settings)
    (warning,) = warnings_of(system, split_of(files))
    assert "degrees" in warning
    assert warnings_of(Description("cart", SETTINGS), split_of(files)) == []


def test_a_constant_variable_is_warned_of(tmp_path: Path) -> None:
    for number in range(4):
        log(seed=number).assign(v=1.5).to_csv(tmp_path / f"{number}.csv", index=False)
    files = (str(tmp_path / "*.csv"),)
    (warning,) = warnings_of(Description("cart", SETTINGS), split_of(files))
    assert "'v' is constant (1.5)" in warning
