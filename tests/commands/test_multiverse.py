"""Command `multiverse`: its default file, and the plan of the committed design."""

from pathlib import Path

import pytest

from study.commands.parser import parse
from tests.helpers.running import study


def test_the_default_file_has_the_design_and_names_the_folder() -> None:
    command, options = parse(["multiverse", "--engine.workers=2"])
    assert command.name == "multiverse"
    assert options.out == Path("results/multiverse")
    assert options.what == "run"
    assert options.config.engine.workers == 2
    assert {"bases", "choices"} <= set(options.multiverse)


@pytest.mark.slow
def test_the_plan_of_the_committed_design(tmp_path: Path) -> None:
    done = study("multiverse", "plan", "--out", tmp_path / "out", "--engine.workers=2")
    assert done.code == 0
    lines = done.out.splitlines()
    names = [line.split()[0] for line in lines]
    assert {"study", "as_written", "random-00", "random-23"} <= set(names)
    shared = [line for line in lines if "shared with universes above" in line]
    assert len(shared) > 40
    assert "stages to run (" in lines[-1]
    assert lines[-1].endswith(" h, 2 at a time")
    assert not (tmp_path / "out").exists()
