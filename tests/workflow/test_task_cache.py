"""Tasks that a run remembers: the same as those found out anew, and only as long as they are."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from study.common import provenance
from study.common.errors import BadInput
from study.config.settings import Config, Tune
from study.workflow.store import Store
from study.workflow.task_cache import record_tasks, topological_order, write_cache
from tests.helpers.running import ROOT, SMOKE, Done

CONFIG = Config()


@pytest.fixture
def remembered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Store:
    store = Store(tmp_path)
    write_cache(CONFIG, record_tasks(CONFIG, store), store)
    return store


def _found_out_anew(store: Store, config: Config, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether the models have to be asked."""

    class Asked(Exception):
        pass

    def ask(_: Config) -> None:
        raise Asked

    monkeypatch.setattr("study.workflow.pipeline.Pipeline", ask)
    try:
        record_tasks(config, store)
    except Asked:
        return True
    return False


def test_the_same_tasks(remembered: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    anew = record_tasks(CONFIG, Store(Path("nowhere")))
    assert not _found_out_anew(remembered, CONFIG, monkeypatch)
    known = record_tasks(CONFIG, remembered)
    assert known == anew
    for one, other in zip(
        topological_order(known.values()), topological_order(anew.values()), strict=True
    ):
        assert (one.name, one.key, one.settings) == (other.name, other.key, other.settings)
        assert {n: t.key for n, t in one.inputs.items()} == {
            n: t.key for n, t in other.inputs.items()
        }


def test_other_settings(remembered: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    assert _found_out_anew(remembered, replace(CONFIG, tune=Tune(trials=9)), monkeypatch)


def test_other_source(remembered: Store, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(provenance, "SOURCE", tmp_path)
    assert _found_out_anew(remembered, CONFIG, monkeypatch)


@pytest.mark.parametrize("old", ['"steps": 600', '"quick"', '"label"', "{", "pusher/low"])
def test_damaged(remembered: Store, old: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = remembered.root / "tasks.json"
    text = path.read_text()
    if old in text:
        path.write_text(text.replace(old, old[:-2] + "_" + old[-1], 1))
        assert _found_out_anew(remembered, CONFIG, monkeypatch)
    path.write_text(text[: len(text) // 2])
    assert _found_out_anew(remembered, CONFIG, monkeypatch)


def test_plugins_are_never_remembered(tmp_path: Path) -> None:
    store, config = Store(tmp_path), replace(CONFIG, plugins=("study.examples.cart",))
    write_cache(config, record_tasks(config, store), store)
    assert not list(tmp_path.iterdir())


def test_unknown_names(tmp_path: Path) -> None:
    grid = replace(CONFIG.grid, models=("full_va",))
    with pytest.raises(BadInput, match="did you mean 'full_vae'"):
        record_tasks(replace(CONFIG, grid=grid), Store(tmp_path))


def test_a_finished_study_is_looked_at_without_torch(smoke: tuple[Path, Done]) -> None:
    out, _ = smoke
    script = (
        "import sys; from study.run import main\n"
        f"for command in ('plan', 'status', 'all'): assert main([command, *{SMOKE!r},"
        f" '--out', {str(out)!r}]) == 0\n"
        "heavy = {'torch', 'lightning', 'mujoco', 'matplotlib', 'distributed'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "0 of 66 stages to run" in done.stdout


def test_the_content_is_json_that_a_person_may_read(remembered: Store) -> None:
    content = json.loads((remembered.root / "tasks.json").read_text())["content"]
    assert {task["stage"] for task in content["tasks"]} >= {"collect", "record"}
