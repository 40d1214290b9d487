"""``tuning.rrd`` holds every trial of a search."""

from dataclasses import asdict
from pathlib import Path

import pytest

from study.common.files import write_json
from study.recording.tuning import read_trials, record_tuning
from tests.helpers import reading, recordings


def test_every_trial_is_recorded(tmp_path: Path) -> None:
    trials, path = recordings.trials(), tmp_path / "tuning.rrd"
    record_tuning(path, trials, recordings.PROPERTIES)
    assert reading.scalars(path, "/beta")["value"].tolist() == [t.beta for t in trials]
    for state in ("complete", "pruned"):
        scores = {t.number: t.score for t in trials if t.state == state}
        assert reading.scalars(path, f"/score/{state}")["value"].to_dict() == scores
    best = reading.scalars(path, "/best")["value"]
    assert best.iloc[-1] == min(t.score for t in trials if t.state == "complete" and t.score)
    curve = reading.scalars(path, "/intermediate/trial_0")["value"].to_dict()
    assert curve == trials[0].intermediate


def test_trials_are_read_with_their_steps_as_numbers(tmp_path: Path) -> None:
    trials = recordings.trials()
    written = [
        asdict(trial) | {"value": None, "intermediate": {str(k): v for k, v in curve.items()}}
        for trial in trials
        for curve in (trial.intermediate,)
    ]
    write_json(tmp_path / "tuning.json", {"beta": 0.1, "trials": written})
    assert read_trials(tmp_path / "tuning.json") == trials


def test_a_search_without_trials_is_recorded(tmp_path: Path) -> None:
    record_tuning(tmp_path / "tuning.rrd", [], {})
    assert reading.entities(tmp_path / "tuning.rrd") == ["/readme"]


@pytest.mark.parametrize("value", ["12", 12, 0.5, "a"])
def test_a_property_has_the_type_that_it_was_written_with(
    value: str | int | float, tmp_path: Path
) -> None:
    # All within one process: Rerun itself drops a value of another type than the one before.
    record_tuning(tmp_path / "t.rrd", recordings.trials(), {"seed": value})
    assert reading.properties(tmp_path / "t.rrd") == {"seed": value}
