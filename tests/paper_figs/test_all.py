"""All scripts: listed once, and each can be run on its own."""

import importlib
import pkgutil
import runpy
import sys
from pathlib import Path
from types import ModuleType

import pytest

import paper_figs
from paper_figs import all as every
from paper_figs.all import SCRIPTS
from paper_figs.command import command
from study.common.errors import BadInput


def test_every_script_of_the_folder_is_in_the_list() -> None:
    names = [
        module.name
        for module in pkgutil.iter_modules(paper_figs.__path__, "paper_figs.")
        if not module.ispkg and module.name != every.__name__
    ]
    modules = [importlib.import_module(name) for name in names]
    scripts = [module for module in modules if hasattr(module, "plot")]
    assert set(scripts) == set(SCRIPTS)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.__name__)
def test_a_script_without_results_is_an_error(tmp_path: Path, script: ModuleType) -> None:
    with pytest.raises(BadInput):
        script.plot(tmp_path / "none")


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("script", [*SCRIPTS, every], ids=lambda script: script.__name__)
def test_a_script_can_be_run_on_its_own(
    script: ModuleType,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["script", str(tmp_path / "none")])
    with pytest.raises(SystemExit) as stop:
        runpy.run_module(script.__name__, run_name="__main__")
    assert stop.value.code == BadInput.exit_code
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert str(tmp_path / "none") in error
    assert error.count("\n") == 1
    assert not (tmp_path / "none").exists()


def test_the_command_line_prints_what_it_writes(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(SCRIPTS[0].plot, "", [str(results)]) == 0
    paths = capsys.readouterr().out.splitlines()
    assert paths
    assert all(Path(line).is_file() for line in paths)
