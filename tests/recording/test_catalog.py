"""The catalog of a study: recordings as segments, with properties and scores as columns."""

import importlib.util
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from study.common.errors import BadInput, StudyError
from study.recording import catalog as module
from study.recording.catalog import Catalog, catalog
from study.recording.forecast import record_forecast
from study.recording.tuning import record_tuning
from study.run import STOPPED, TERMINATED
from tests.helpers import recordings
from tests.helpers.running import start

README = Path(module.__file__).with_name("README.md")
LOW, HIGH = "uav/low/residual_vae/seed-0", "uav/high/residual_vae/seed-0"
NUMBERS = {LOW: {"mmd2": 0.25, "brier": 0.5, "beta": 30.0}}


def write(root: Path) -> Path:
    """The forecasts of two cells, of which the first has a search too."""
    puck = recordings.Puck()
    examples = [replace(e, title="median MMD²") for e in recordings.examples(puck, 1)]
    for cell in (LOW, HIGH):
        environment, level, model, _ = cell.split("/")
        properties = {"cell": cell, "environment": environment, "level": level, "model": model}
        (root / cell).mkdir(parents=True)
        record_forecast(root / cell / "forecast.rrd", puck, examples, properties | {"seed": 0})
    record_tuning(root / LOW / "tuning.rrd", recordings.trials(), properties | {"cell": LOW})
    return root


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("catalog") / "recordings")


@pytest.fixture(scope="module")
def served(folder: Path) -> Iterator[Catalog]:
    pytest.importorskip("datafusion", reason="needs the extra catalog: pip install -e '.[catalog]'")
    with catalog(folder, NUMBERS) as started:
        yield started


def test_sigterm_leaves_no_temporary_folder(folder: Path, tmp_path: Path) -> None:
    """The process is one of the command `catalog`."""
    pytest.importorskip("datafusion")
    out, temporary = tmp_path / "out", tmp_path / "tmp"
    shutil.copytree(folder, out / "recordings")
    (out / "study.json").write_text("{}")
    temporary.mkdir()
    process = start("catalog", "--out", out, TMPDIR=str(temporary))
    assert process.stdout is not None
    while "Ctrl-C" not in (line := process.stdout.readline()):
        assert line or process.poll() is None, process.communicate()
    assert list(temporary.glob("study-catalog-*"))
    process.terminate()
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (TERMINATED, f"{STOPPED}\n")
    assert not list(temporary.iterdir())


def dataset(served: Catalog, name: str) -> Any:
    from rerun.catalog import CatalogClient

    return CatalogClient(served.address).get_dataset(name)


def test_each_kind_and_environment_is_a_dataset(served: Catalog) -> None:
    assert served.datasets == {"forecast_uav": 2, "tuning_uav": 1}
    assert served.problems == []
    assert urlsplit(served.address).hostname == "127.0.0.1"


def test_properties_and_scores_are_columns(served: Catalog) -> None:
    columns = {name: f"property:study:{name}" for name in ("cell", "level", "seed", *NUMBERS[LOW])}
    found = dataset(served, "forecast_uav")
    table = found.segment_table().to_pydict()
    rows = {
        table[columns["cell"]][i][0]: {name: table[columns[name]][i] for name in columns}
        for i in range(2)
    }
    assert rows[LOW] == {
        "cell": [LOW], "level": ["low"], "seed": [0], "mmd2": [0.25], "brier": [0.5], "beta": [30.0]
    }  # fmt: skip
    assert rows[HIGH] == {
        "cell": [HIGH], "level": ["high"], "seed": [0], "mmd2": None, "brier": None, "beta": None
    }  # fmt: skip


def test_the_layouts_of_recordings_and_table_are_registered(served: Catalog) -> None:
    for name in served.datasets:
        found = dataset(served, name)
        layouts = {found.default_blueprint(), found.default_segment_table_blueprint()}
        assert layouts == set(found.blueprints())
        assert len(layouts) == 2


def test_ids_are_unique_to_cell_and_kind_and_say_so(served: Catalog) -> None:
    ids = [i for name in served.datasets for i in dataset(served, name).segment_ids()]
    assert len(set(ids)) == 3
    names = {i.rsplit("/", 1)[0] for i in ids}
    assert names == {f"{LOW}/forecast", f"{HIGH}/forecast", f"{LOW}/tuning"}


def test_the_query_of_the_readme(served: Catalog) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert len(code.splitlines()) == 5
    values: dict[str, Any] = {}
    code = code.replace("rerun+http://127.0.0.1:9900", served.address)
    exec(code, values)
    frame = values["frame"]
    assert set(frame["rerun_segment_id"].str.startswith(f"{LOW}/")) == {True}
    assert list(frame["horizon"]) == list(range(1, 31))
    quantiles = frame["/median_mmd²/state/x:Scalars:scalars"]
    assert {len(row) for row in quantiles} == {10}
    names = next(column for column in frame if column.endswith(":names"))
    assert list(frame[names][0][:2]) == ["observed 5%", "observed 25%"]


def test_a_damaged_recording_is_left_out_and_named(tmp_path: Path, served: Catalog) -> None:
    root = write(tmp_path / "recordings")
    damaged = root / LOW / "tuning.rrd"
    damaged.write_bytes(damaged.read_bytes()[:-100])
    with catalog(root, {}) as started:
        assert started.datasets == {"forecast_uav": 2}
        (problem,) = started.problems
        assert problem.startswith(f"recording {damaged} is damaged")
        assert "\n" not in problem


def test_without_recordings_or_a_free_port(tmp_path: Path, served: Catalog) -> None:
    with pytest.raises(BadInput, match=r"there are no recordings in .*run python"):
        catalog(tmp_path, {}).__enter__()
    (tmp_path / "a.rrd").write_bytes(b"nothing")
    with pytest.raises(StudyError, match=r"no recording in .* can be read"):
        catalog(tmp_path, {}).__enter__()
    for port in (urlsplit(served.address).port or 0, 70000, -1):
        with pytest.raises(BadInput, match=f"--port: cannot listen on {port}: .*give another"):
            catalog(tmp_path, {}, port).__enter__()


def test_without_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(module, "find_spec", lambda name: name != "datafusion" and find(name))
    with pytest.raises(StudyError) as error:
        catalog(tmp_path, {}).__enter__()
    assert str(error.value) == "the catalog needs datafusion: pip install -e '.[catalog]'"
