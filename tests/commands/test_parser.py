"""Bad input gets one line that names the setting, what was given and what is allowed."""

import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from study.commands.parser import COMMANDS, parse
from study.commands.settings import CONFIGS
from study.config.tree import keys
from study.run import main

BAD = [
    (["al"], "did you mean 'all'?"),
    ([], "a command is missing"),
    (["--config", "x.yaml", "all"], "is before the command"),
    (["all", "--tune.trial", "3"], "did you mean 'tune.trials'?"),
    (["all", "--trials", "3"], "tune.trials"),
    (["all", "--tune.trials", "many"], "tune.trials: got 'many'; it must be a whole number"),
    (["all", "--tune.trials", "1.5"], "tune.trials: got 1.5; it must be a whole number"),
    (["all", "--train.learning_rate", "fast"], "it must be a number"),
    (["all", "--grid.seeds", "3"], "a list of whole numbers"),
    (["all", "--grid.seeds", "[]"], "at least one value"),
    (["all", "--grid.seeds", "[0, 0]"], "once"),
    (["all", "--grid.seeds", "[-1]"], "grid.seeds: got -1; it must be between 0 and"),
    (["all", "--collect.rollouts", "-3"], "rollouts: got -3; it must be between 2 and 10000"),
    (["all", "--collect.horizon", "0"], "collect.horizon: got 0; it must be between 2 and 10000"),
    (["all", "--collect.horizon", "long"], "a whole number or null"),
    (["all", "--collect.trajectories", "5"], "level high needs at least 2"),
    (["all", "--train.learning_rate", "0"], "train.learning_rate: got 0"),
    (["all", "--tune.beta_low", "2", "--tune.beta_high", "1"], "at most tune.beta_high"),
    (["all", "--tune.trials", "101", "--tune.batch", "2"], "at most 50 batches need at least 3"),
    (["all", "--ensemble.cross_fit", "true", "--ensemble.members", "1"], "needs at least 2"),
    (["all", "--vae.teacher_forcing", "alway"], "did you mean 'always'?"),
    (["all", "--engine.kind", "dusk"], "did you mean 'dask'?"),
    (["all", "--engine.address", "host:8786"], "got 'host:8786'; it must be like tcp://host:8786"),
    (
        ["all", "--engine.kind=serial", "--engine.address=tcp://host:1"],
        "got 'tcp://host:1' with engine.kind serial; it needs --engine.kind dask",
    ),
    (["all", "--grid.environments", "[pushr]"], "did you mean 'pusher'?"),
    (["all", "--grid.models", "[full_va]"], "did you mean 'full_vae'?"),
    (["all", "--grid.levels", "[medium]"], "give one of low, high"),
    (["all", "--only", "pusher/lo/*"], "no cell matches"),
    (["all", "--plugins", "[no_such_module]"], "cannot import 'no_such_module'"),
    (["all", "--name", "a/b"], "it names a folder"),
    (["all", "--out"], "its value is missing"),
    (["all", "surplus"], "surplus"),
    (["all", "--config", "configs/quik.yaml"], "did you mean 'configs/quick.yaml'?"),
    (["all", "--out", "/proc/nowhere"], "cannot write"),
    (["view", "pusher/low/residual_va/seed-0"], "did you mean 'pusher/low/residual_vae/seed-0'?"),
    (["view", "pusher/low/oracle/seed-0", "--kind", "score"], "did you mean 'scores'?"),
    (["view", "pushr"], "did you mean 'pusher'?"),
    (["view", "stuyd"], "did you mean 'study'?"),
    (["compare", "pusher/low/oracle/seed-0"], "two cells"),
    (["compare", *["pusher/low/oracle/seed-0"] * 2], "two cells"),
    (["compare", "pusher/low/oracle/seed-0", "pusher/low/oracl/seed-0"], "oracle/seed-0'?"),
]


@pytest.mark.parametrize(("arguments", "expected"), BAD, ids=lambda value: " ".join(value)[:60])
def test_one_line_and_nothing_written(
    arguments: list[str],
    expected: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "configs").symlink_to(CONFIGS)
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("error: ")
    assert printed.err.count("\n") == 1
    assert expected in printed.err
    assert sorted(tmp_path.rglob("*")) == before


def test_a_results_folder_of_another_version(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "study.json").write_text('{"format": 99}')
    assert main(["plan", "--out", str(tmp_path)]) == 2
    assert "made by another version" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["study.json"]


def test_no_traceback_from_another_process() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "study.run", "all", "--tune.trials", "x"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr == "error: tune.trials: got 'x'; it must be a whole number\n"


def test_help_lists_every_setting(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        parse(["all", "--help"])
    assert stopped.value.code == 0
    text = capsys.readouterr().out
    assert all(f"--{key}" in text for key in keys())


@pytest.mark.parametrize("name", COMMANDS)
def test_help_explains_each_command(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        parse([name, "--help"])
    assert stopped.value.code == 0
    text = capsys.readouterr().out
    assert COMMANDS[name].summary in text
    assert f"python -m study.run {name} " in text.split("example")[1] + " "
    assert all(f"\n  {flag} " in text for flag in COMMANDS[name].flags)


def test_the_examples_of_each_help_are_valid() -> None:
    """They are parsed, not run; the list of `ablate` is checked when it runs."""
    for command in COMMANDS.values():
        lines = [line.strip() for line in command.details.splitlines()]
        examples = [line for line in lines if line.startswith("python -m study.run ")]
        assert examples
        for example in examples:
            _, _, _, name, *arguments = shlex.split(example)
            found, _ = parse([name, *arguments])
            assert found.name == name


def test_help_plan_and_status_import_nothing_heavy() -> None:
    program = (
        "import sys; import study.run; from study.commands.parser import usage; usage();"
        "import study.commands.plan, study.commands.status;"
        "print(*{'torch', 'lightning', 'mujoco', 'matplotlib', 'rerun'} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == ""
