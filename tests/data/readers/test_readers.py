"""Each format, written by its own writer or byte by byte, and read back."""

import json
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from study.common.arrays import Array
from study.common.errors import BadInput, StudyError
from study.data import readers
from study.data.readers import digests, files_of, format_of, read
from study.data.readers.table import Table

TIME = 0.1 * np.arange(5)
VALUES = np.linspace(-1, 1, 5)
YAW = 0.3 * np.arange(5)


def by_name(tables: list[Table]) -> dict[str, Table]:
    return {table.name: table for table in tables}


def ulog(path: Path, topics: Mapping[str, Mapping[str, Array]]) -> bytes:
    """A ULog file with topics of float32 fields, as section "ULog File Format" of PX4 describes."""

    def message(kind: str, content: bytes) -> bytes:
        return struct.pack("<HB", len(content), ord(kind)) + content

    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)]
    for name, fields in topics.items():
        sizes = [f"float[{len(v.T)}]" if v.ndim > 1 else "float" for v in fields.values()]
        listed = "".join(f"{size} {field};" for size, field in zip(sizes, fields, strict=True))
        parts.append(message("F", f"{name}:uint64_t timestamp;{listed}".encode()))
    for number, name in enumerate(topics):
        parts.append(message("A", struct.pack("<BH", 0, number) + name.encode()))
    for number, fields in enumerate(topics.values()):
        for row, seconds in enumerate(TIME):
            numbers = np.concatenate([np.atleast_1d(v[row]) for v in fields.values()])
            data = struct.pack("<HQ", number, round(1e6 * seconds) + 1000)
            parts.append(message("D", data + numbers.astype("<f4").tobytes()))
    content = b"".join(parts)
    path.write_bytes(content)
    return content


def test_csv_and_parquet(tmp_path: Path) -> None:
    frame = pd.DataFrame({"time": TIME, "x": VALUES})
    frame.to_csv(tmp_path / "log.csv", index=False)
    frame.to_parquet(tmp_path / "log.parquet")
    for name in ("log.csv", "log.parquet"):
        (table,) = read(tmp_path / name)
        np.testing.assert_allclose(table.columns["x"], VALUES)
    frame.assign(time=pd.to_datetime(frame["time"], unit="s")).to_parquet(
        tmp_path / "dates.parquet"
    )
    (table,) = read(tmp_path / "dates.parquet")
    np.testing.assert_allclose(table.columns["time"], TIME, atol=1e-6)


def test_ulog_with_the_angles_of_quaternions(tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    q = np.stack([np.cos(YAW / 2), 0 * YAW, 0 * YAW, np.sin(YAW / 2)], axis=1)
    path = tmp_path / "log.ulg"
    ulog(path, {"vehicle_attitude": {"q": q}, "cmd": {"u": VALUES}})
    tables = by_name(read(path))
    np.testing.assert_allclose(
        tables["vehicle_attitude"].columns["vehicle_attitude.yaw"], YAW, atol=1e-6
    )
    np.testing.assert_allclose(
        tables["vehicle_attitude"].columns["vehicle_attitude.roll"], 0, atol=1e-6
    )
    np.testing.assert_allclose(tables["cmd"].columns["cmd.u"], VALUES, atol=1e-6)
    assert tables["cmd"].time is not None
    np.testing.assert_allclose(np.diff(tables["cmd"].time), 0.1, atol=1e-6)


@pytest.mark.parametrize("lost", [1, 5, 9])
def test_a_truncated_ulog_is_refused(tmp_path: Path, lost: int) -> None:
    pytest.importorskip("pyulog")
    path = tmp_path / "log.ulg"
    content = ulog(path, {"cmd": {"u": VALUES}})
    path.write_bytes(content[:-lost])
    with pytest.raises(BadInput, match=r"log\.ulg: the ULog is truncated: .* byte \d+"):
        read(path)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_ros_2_bags(tmp_path: Path, storage: str) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.LATEST)
    message, point = store.types["geometry_msgs/msg/Pose"], store.types["geometry_msgs/msg/Point"]
    turn = store.types["geometry_msgs/msg/Quaternion"]
    folder = tmp_path / "bag"
    with rosbag2.Writer(folder, version=9, storage_plugin=rosbag2.StoragePlugin[storage]) as bag:
        connection = bag.add_connection("/robot/pose", message.__msgtype__, typestore=store)
        for seconds, x, yaw in zip(TIME, VALUES, YAW, strict=True):
            pose = message(point(x, 0.0, 0.0), turn(0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)))
            raw = store.serialize_cdr(pose, message.__msgtype__)
            bag.write(connection, round(1e9 * seconds) + 1, raw)
    for path in (folder, *folder.glob("*.mcap"), *folder.glob("*.db3")):
        (table,) = read(path)
        np.testing.assert_allclose(table.columns["robot.pose.position.x"], VALUES)
        np.testing.assert_allclose(table.columns["robot.pose.yaw"], YAW, atol=1e-9)
        assert table.time is not None
        np.testing.assert_allclose(table.time, TIME, atol=1e-6)
    for path in (*folder.glob("*.mcap"), *folder.glob("*.db3")):
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        with pytest.raises(BadInput, match="it may be truncated"):
            read(path)


def test_minari(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    folder = tmp_path / "set"
    (folder / "data").mkdir(parents=True)
    with h5py.File(folder / "data" / "main_data.hdf5", "w") as file:
        for number in (0, 1, 10, 2):
            episode = file.create_group(f"episode_{number}")
            episode["observations"] = np.full((5, 2), float(number))
            episode["actions"] = np.zeros((4, 1))
    (table,) = read(folder)
    assert list(table.columns) == ["observation[0]", "observation[1]", "action[0]"]
    assert table.trajectory is not None
    assert list(dict.fromkeys(table.trajectory.tolist())) == [0, 1, 2, 10]
    np.testing.assert_array_equal(table.columns["observation[0]"], table.trajectory)
    assert np.isnan(table.columns["action[0]"][4::5]).all()


def test_lerobot(tmp_path: Path) -> None:
    folder = tmp_path / "set"
    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    names = {
        "observation.state": {"names": ["pan", "lift"]},
        "action": {"names": {"motors": ["m"]}},
    }
    (folder / "meta" / "info.json").write_text(json.dumps({"features": names}), encoding="utf-8")
    for file in range(2):
        rows = {
            "observation.state": [[float(v), float(file)] for v in VALUES],
            "action": [[float(v)] for v in VALUES],
            "timestamp": TIME,
            "episode_index": [file] * 5,
            "frame_index": range(5),
        }
        pd.DataFrame(rows).to_parquet(folder / "data" / "chunk-000" / f"file-{file:03}.parquet")
    (table,) = read(folder)
    assert list(table.columns) == ["observation.state.pan", "observation.state.lift", "action.m"]
    assert table.trajectory is not None
    np.testing.assert_array_equal(table.columns["observation.state.lift"], table.trajectory)
    np.testing.assert_allclose(table.columns["action.m"], np.tile(VALUES, 2))


def test_a_missing_package_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.ulg"
    path.write_bytes(b"")

    def missing(name: str) -> None:
        raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr(readers, "import_module", missing)
    with pytest.raises(StudyError, match=r"needs pyulog .*pip install -e '\.\[ulog\]'"):
        read(path)


def test_a_format_is_by_ending_or_folder(tmp_path: Path) -> None:
    assert format_of(Path("a/LOG.ULG")) == "ulog"
    with pytest.raises(BadInput, match=r"unknown ending '\.xyz'"):
        format_of(Path("a.xyz"))
    with pytest.raises(BadInput, match="the folder is no LeRobot"):
        format_of(tmp_path)


def test_patterns_and_copies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("b.csv", "a.csv"):
        Path(name).write_text(f"x\n{name}\n", encoding="utf-8")
    assert files_of(("*.csv", "b.csv"), "bot.files") == [Path("a.csv"), Path("b.csv")]
    assert set(digests(files_of(("*.csv",), "bot.files"))) == {"a.csv", "b.csv"}
    with pytest.raises(BadInput, match=r"bot\.files: got 'c\*'; no file matches"):
        files_of(("c*",), "bot.files")
    Path("c.csv").write_bytes(Path("a.csv").read_bytes())
    with pytest.raises(BadInput, match=r"c\.csv: it has the same content as a\.csv"):
        digests(files_of(("*.csv",), "bot.files"))


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", b"t,x,x\n1,2,3\n", "names 2 columns 'x'"),
        ("a.csv", b"t,x\n1,2,3\n2,3,4\n", "line 2 has 3 values, and line 1 has 2 names"),
        ("a.csv", b"t,x\n1,2\n1,2,3\n", "line 3, saw 3"),
        ("a.csv", "t,ö\n1,2\n".encode("latin-1"), "no UTF-8 text"),
        ("a.csv", b"", "empty"),
        ("a.ulg", b"hello" * 100, "no ULog file"),
        ("a.db3", b"hello" * 100, r"no metadata\.yaml"),
    ],
)
def test_a_damaged_file_is_refused(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    for package in {"a.ulg": ["pyulog"], "a.db3": ["rosbags"]}.get(name, []):
        pytest.importorskip(package)
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BadInput, match=rf"a\.\w+: .*{message}"):
        read(tmp_path / name)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_the_separator_of_a_csv_file_is_that_of_its_header(tmp_path: Path, separator: str) -> None:
    frame = pd.DataFrame({"time": TIME, "x": VALUES})
    frame.to_csv(tmp_path / "log.csv", index=False, sep=separator)
    (table,) = read(tmp_path / "log.csv")
    np.testing.assert_allclose(table.columns["x"], VALUES)
