"""A file that is not complete is found before a checksum seals it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import rerun as rr
from matplotlib.figure import Figure

from study.common.errors import StudyError
from study.common.files import write_json
from study.common.read_back import READERS, read_back
from study.data.storage import save_arrays

NUMBERS = np.random.default_rng(0).normal(size=20_000).astype(np.float32)


def _recording(path: Path) -> None:
    with rr.RecordingStream("test") as stream:
        stream.save(path)
        times = [rr.TimeColumn("step", sequence=np.arange(len(NUMBERS)))]
        stream.send_columns("numbers", times, rr.Scalars.columns(scalars=NUMBERS))
    stream.disconnect()


def _figure(path: Path) -> None:
    figure = Figure()
    figure.subplots().plot(NUMBERS)
    figure.savefig(path)


WRITERS: dict[str, Callable[[Path], None]] = {
    "rrd": _recording,
    "parquet": lambda path: pd.DataFrame({"number": NUMBERS}).to_parquet(path),
    "safetensors": lambda path: save_arrays(path, {"numbers": NUMBERS}),
    "png": _figure,
    "pdf": _figure,
    "json": lambda path: write_json(path, NUMBERS.tolist()),
    "csv": lambda path: pd.DataFrame({"number": NUMBERS}).to_csv(path),
}


@pytest.mark.parametrize("ending", WRITERS)
@pytest.mark.parametrize("kept", [0.0, 0.5, 0.99])
def test_a_file_that_was_cut_off_is_found(tmp_path: Path, ending: str, kept: float) -> None:
    path = tmp_path / f"file.{ending}"
    WRITERS[ending](path)
    read_back(path)
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    if ending == "csv" and kept == 0:
        read_back(path)  # a text may be empty
        return
    with pytest.raises(StudyError, match=r"not written completely .*; is the disk full") as error:
        read_back(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_every_format_of_the_study_is_read(tmp_path: Path) -> None:
    assert {*WRITERS, "html", "log", "md", "sha256", "tex"} == set(READERS)


def test_a_temporary_file_is_read_as_what_it_will_be(tmp_path: Path) -> None:
    path = tmp_path / ".file.json.new"
    path.write_text("{")
    read_back(path)
    with pytest.raises(StudyError, match=r"/file\.json was not written"):
        read_back(path, tmp_path / "file.json")
