"""The tabs of a recording's layout, and a layout in which one of them is open."""

from dataclasses import replace
from pathlib import Path

import pytest

from study.common.errors import StudyError
from study.recording.forecast import record_forecast
from study.recording.properties import Properties
from study.recording.reading import read_properties, reader
from study.recording.tabs import Layout, scenario_numbers
from study.recording.tuning import record_tuning
from tests.helpers import recordings

PROPERTIES: Properties = {"cell": "puck/low/vae/seed-0", "environment": "puck", "seed": 0}


@pytest.fixture(scope="module")
def forecast(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tabs") / "forecast.rrd"
    puck = recordings.Puck()
    record_forecast(path, puck, recordings.examples(puck, 2), PROPERTIES)
    return path


def active_tab(path: Path) -> str | None:
    """The tab that is open in a layout file; None for the first."""
    file = reader(path)
    (store,) = file.blueprints()
    for chunk in file.stream(store=store):
        values = chunk.to_record_batch().to_pydict().get("ContainerBlueprint:active_tab")
        if values:
            return str(values[-1][0])
    return None


def test_each_example_is_a_tab(forecast: Path) -> None:
    assert Layout(forecast).tabs == ["median", "best", "README"]


def test_a_layout_opens_a_tab(forecast: Path, tmp_path: Path) -> None:
    layout, path = Layout(forecast), tmp_path / "layout.rbl"
    found = []
    for tab in (0, 1):
        path.write_bytes(layout.opened(tab))
        found.append(active_tab(path))
        assert Layout(path).tabs == layout.tabs
        assert Layout(path).application == layout.application == "study_forecast_puck"
    assert None not in found
    assert found[0] != found[1]
    assert active_tab(forecast) is None


def test_a_recording_without_tabs(tmp_path: Path) -> None:
    path = tmp_path / "tuning.rrd"
    record_tuning(path, recordings.trials(), {})
    assert Layout(path).tabs == []


def test_numbers_of_scenarios_are_those_of_the_panels(tmp_path: Path) -> None:
    puck, path = recordings.Puck(), tmp_path / "forecast.rrd"
    first, second = recordings.examples(puck, 2)
    first = replace(first, description="Scenario 17 of the test set, chosen by this rule: *a*.")
    record_forecast(path, puck, [first, replace(second, description="A plan.")], {})
    assert scenario_numbers(path) == {first.title: 17}


def test_properties_are_read_back(forecast: Path) -> None:
    assert read_properties(forecast) == PROPERTIES


@pytest.mark.parametrize("read", [Layout, scenario_numbers, read_properties])
def test_a_file_that_is_no_recording(read: type[Layout], tmp_path: Path) -> None:
    for content in (b"", b"RRF2", b"nothing at all"):
        path = tmp_path / "forecast.rrd"
        path.write_bytes(content)
        with pytest.raises(StudyError, match=r"recording .*forecast\.rrd"):
            read(path)
