"""``data.rrd`` holds the same numbers as the trajectories, is small, and explains itself."""

from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from study.common.errors import StudyError
from study.common.seeds import spawn
from study.data.trajectories import Trajectories
from study.data.variables import Variable
from study.recording import data as data_recording
from study.recording.data import record_data
from study.recording.integrity import check
from tests.helpers import recordings
from tests.helpers.reading import document, entities, properties, scalars


def trajectories(count: int = 5) -> Trajectories:
    simulator, seeds = recordings.Puck(), spawn(0, count)
    scenarios = simulator.sample_scenarios(seeds)
    actions = simulator.plan(scenarios, seeds)
    rollout = simulator.rollout(scenarios.s0, actions, seeds)
    return Trajectories(rollout.states, actions, scenarios.goal, rollout.unobserved, {})


def test_signals_are_those_of_the_trajectories(tmp_path: Path) -> None:
    data, path = trajectories(), tmp_path / "data.rrd"
    record_data(path, recordings.Puck(), data, recordings.PROPERTIES)
    check(path)
    assert properties(path)["cell"] == recordings.PROPERTIES["cell"]
    assert {"/state/x", "/state/y", "/action/f_x", "/action/f_y"} <= set(entities(path))
    for column, name in ((0, "x"), (1, "y")):
        read = scalars(path, f"/state/{name}").to_numpy(np.float64)
        np.testing.assert_allclose(read[:, -5:], data.states[..., column].T, rtol=1e-6)
    assert path.stat().st_size < 1_000_000


class Weighted(recordings.Puck):
    """A puck with an unobserved load."""

    unobserved: ClassVar[tuple[Variable, ...]] = (Variable("load", "kg", "mass carried"),)


def test_unobserved_variables_are_recorded_for_each_trajectory(tmp_path: Path) -> None:
    load = np.array([[0.1], [0.5], [0.2], [np.inf], [0.4]], dtype=np.float32)
    path = tmp_path / "data.rrd"
    record_data(path, Weighted(), replace(trajectories(), unobserved=load), recordings.PROPERTIES)
    read = scalars(path, "/unobserved/load")["value"].to_numpy()
    assert np.isnan(read[3])
    np.testing.assert_allclose(read[[0, 1, 2, 4]], load[[0, 1, 2, 4], 0])


@pytest.mark.parametrize("tiny", [0.02, 100.0])
def test_the_text_explains_a_close_up_where_there_is_one(
    tiny: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(data_recording, "_TINY", tiny)
    record_data(tmp_path / "data.rrd", recordings.Puck(), trajectories(), recordings.PROPERTIES)
    text = document(tmp_path / "data.rrd", "/closest/about")
    assert ("*Close-up*" in text) == (tiny > 1)
    assert "- *Distance to the target*" in text


def test_a_trajectory_is_drawn_up_to_its_last_finite_state(tmp_path: Path) -> None:
    data, path = trajectories(), tmp_path / "data.rrd"
    states = data.states.copy()
    states[2, 7:] = np.nan
    states[4] = np.inf
    record_data(path, recordings.Puck(), replace(data, states=states), recordings.PROPERTIES)
    read = scalars(path, "/state/x").to_numpy(np.float64)
    assert np.isfinite(read[:7, 2]).all()
    assert np.isnan(read[7:, 2]).all()
    assert np.isnan(read[:, 4]).all()
    np.testing.assert_allclose(read[:, 0], states[0, :, 0], rtol=1e-6)


@pytest.mark.parametrize("harm", ["flip", "cut"])
def test_damage_is_found_and_named(harm: str, tmp_path: Path) -> None:
    path = tmp_path / "data.rrd"
    record_data(path, recordings.Puck(), trajectories(), recordings.PROPERTIES)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content if harm == "flip" else path.read_bytes()[:-1])
    with pytest.raises(StudyError, match=r"data\.rrd is damaged"):
        check(path)
