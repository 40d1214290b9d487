"""Files of arrays: the same bytes in parts or together, a checksum, and mapped arrays."""

from pathlib import Path

import numpy as np
import pytest

from study.common.errors import StudyError
from study.common.progress import Progress
from study.data.moments import moments
from study.data.normalization import Normalization
from study.data.storage import Arrays, load_arrays, load_parts, save_arrays, save_parts
from study.data.trajectories import ScenarioSet, Trajectories, concatenate, save_all
from study.envs.observe import CHUNK, observe_scenarios, observe_trajectories
from study.examples.cart import Cart

ROWS = 23
FACTS = {"unit": "°/s", "quoted": 'a "b" \\', "bounds": [None, 1.5]}


def arrays() -> Arrays:
    generator = np.random.default_rng(1)
    shapes = {
        "states": (ROWS, 6, 3),
        "actions": (ROWS, 5, 1),
        "unobserved": (ROWS, 0),
        "b": (ROWS,),
    }
    return {
        name: generator.standard_normal(shape).astype(np.float32) for name, shape in shapes.items()
    }


def parts(sizes: list[int], whole: Arrays) -> list[Arrays]:
    ends = np.cumsum(sizes)
    return [
        {name: array[end - size : end] for name, array in whole.items()}
        for size, end in zip(sizes, ends, strict=True)
    ]


@pytest.mark.parametrize("sizes", [[ROWS], [10, 10, 3], [1] * ROWS])
def test_parts_give_the_same_bytes(sizes: list[int], tmp_path: Path) -> None:
    whole = arrays()
    save_arrays(tmp_path / "whole", whole, FACTS)
    save_parts(tmp_path / "parts", iter(parts(sizes, whole)), ROWS, FACTS)
    assert (tmp_path / "parts").read_bytes() == (tmp_path / "whole").read_bytes()


def test_all_types_of_numbers_are_read_back(tmp_path: Path) -> None:
    kinds = ["?", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f2", "f4", "f8"]
    whole = {kind: np.arange(12).reshape(3, 4).astype(kind) for kind in kinds}
    whole |= {"none": np.zeros((0, 4), np.float32), "turned": np.arange(6.0).reshape(2, 3).T}
    save_arrays(tmp_path / "file", whole, FACTS)
    loaded, facts = load_arrays(tmp_path / "file")
    assert facts == FACTS
    assert loaded.keys() == whole.keys()
    for name, array in whole.items():
        assert loaded[name].dtype == array.dtype
        np.testing.assert_array_equal(loaded[name], array)


def test_writing_into_loaded_arrays_does_not_change_the_file(tmp_path: Path) -> None:
    save_arrays(tmp_path / "file", arrays())
    loaded, _ = load_arrays(tmp_path / "file")
    loaded["states"] += 1
    reloaded, _ = load_arrays(tmp_path / "file")
    np.testing.assert_array_equal(reloaded["states"], arrays()["states"])


@pytest.mark.parametrize("sizes", [[10, 10], [10, 10, 10], [20]])
def test_the_number_of_rows_is_checked(sizes: list[int], tmp_path: Path) -> None:
    whole = {name: np.concatenate([array, array]) for name, array in arrays().items()}
    with pytest.raises(ValueError, match="rows"):
        save_parts(tmp_path / "file", parts(sizes, whole), ROWS)
    assert not list(tmp_path.iterdir())
    with pytest.raises(StudyError, match="cannot read"):
        load_arrays(tmp_path / "file")


def test_the_shapes_of_parts_are_checked(tmp_path: Path) -> None:
    first, second = parts([10, 13], arrays())
    second["states"] = second["states"][:, :5]
    with pytest.raises(ValueError, match="do not fit"):
        save_parts(tmp_path / "file", [first, second], ROWS)


@pytest.mark.parametrize("rows", [1, 10, ROWS, 100])
def test_one_array_is_read_part_by_part(rows: int, tmp_path: Path) -> None:
    whole = arrays()
    save_arrays(tmp_path / "file", whole)
    for name, array in whole.items():
        loaded = list(load_parts(tmp_path / "file", name, rows))
        assert max(map(len, loaded)) == min(rows, ROWS)
        np.testing.assert_array_equal(np.concatenate(loaded), array)


@pytest.mark.parametrize("position", [3, 40, -200, -1])
def test_every_damage_is_found(position: int, tmp_path: Path) -> None:
    path = tmp_path / "file"
    save_arrays(path, arrays(), FACTS)
    content = bytearray(path.read_bytes())
    content[position] ^= 4
    path.write_bytes(content)
    with pytest.raises(StudyError, match="file"):
        load_arrays(path)
    path.write_bytes(content[:-1])
    with pytest.raises(StudyError, match="cannot read"):
        load_arrays(path)


@pytest.mark.parametrize("size", [2, 3, 7, 14])
def test_moments_equal_those_of_the_whole_bit_for_bit(size: int) -> None:
    values = np.random.default_rng(size).normal(5.0, 2.0, (700, 13, size)).astype(np.float32)
    for step in (1000, 333, 1):
        starts = range(0, len(values), step)
        mean, deviation = moments(lambda: (values[s : s + step] for s in starts))  # noqa: B023
        np.testing.assert_array_equal(mean, values.mean(axis=(0, 1), dtype=np.float64))
        np.testing.assert_array_equal(deviation, values.std(axis=(0, 1), dtype=np.float64))


def test_normalization_does_not_depend_on_the_chunk_size(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    train = concatenate(observe_trajectories(Cart(), 50, 0, Progress()))
    whole = Normalization.from_trajectories(train)
    monkeypatch.setattr("study.data.normalization.CHUNK", 7)
    for name, value in vars(Normalization.from_trajectories(train)).items():
        np.testing.assert_array_equal(value, getattr(whole, name))
    changes = np.diff(train.states, axis=1) / whole.state_scale
    expected = changes.std(axis=(0, 1), dtype=np.float64).astype(np.float32)
    np.testing.assert_array_equal(whole.delta_std, expected)


def test_data_sets_do_not_depend_on_the_chunk_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:

    def files(chunk: int) -> tuple[bytes, ...]:
        monkeypatch.setattr("study.envs.observe.CHUNK", chunk)
        train = observe_trajectories(Cart(), 9, 0, Progress())
        save_all(tmp_path / "train", train, 9)
        save_all(tmp_path / "test", observe_scenarios(Cart(), 5, 3, 0, Progress()), 5)
        return tuple((tmp_path / name).read_bytes() for name in ("train", "test"))

    concatenate(observe_trajectories(Cart(), 9, 0, Progress())).save(tmp_path / "whole")
    assert files(CHUNK) == files(6) == files(2)
    assert (tmp_path / "train").read_bytes() == (tmp_path / "whole").read_bytes()
    assert len(Trajectories.load(tmp_path / "train")) == 9
    assert ScenarioSet.load(tmp_path / "test").observed.shape[:2] == (5, 3)
