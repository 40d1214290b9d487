"""Command `multiverse`: its default file, the plan of the committed design, and wrong input."""

from pathlib import Path

import pytest

from study.commands.parser import parse
from study.commands.settings import CONFIGS
from tests.helpers.running import study
from tests.helpers.small_multiverse import written_design


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


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["pln"], "multiverse: got 'pln'; did you mean 'plan'?"),
        (["--universes", "stdy"], "--universes: none matches 'stdy'; did you mean 'study'?"),
        (["--mlp.loss=nll"], "mlp.loss: got 'nll', but the choice 'loss' sets it"),
        (["--mlp.los=nll"], "unknown setting 'mlp.los'"),
    ],
)
def test_arguments_that_are_wrong(arguments: list[str], expected: str, tmp_path: Path) -> None:
    given = ("multiverse", *arguments, "--config", written_design(tmp_path))
    done = study(*given, "--out", tmp_path / "out")
    assert done.code == 2
    assert expected in done.err
    assert done.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_file_of_settings_without_a_design(tmp_path: Path) -> None:
    done = study("multiverse", "--config", CONFIGS / "smoke.yaml", "--out", tmp_path / "out")
    assert done.code == 2
    assert "multiverse: missing in the file of settings; see configs/multiverse.yaml" in done.err


def test_other_commands_refuse_the_design(tmp_path: Path) -> None:
    done = study("plan", "--config", written_design(tmp_path), "--out", tmp_path / "out")
    assert done.code == 2
    assert "unknown setting 'multiverse'" in done.err
