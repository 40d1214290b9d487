"""Universes that were run apart, joined into one multiverse."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from study.common.files import read_json, write_json
from study.multiverse.folder import read, write
from study.results import checksums, multiverse
from tests.helpers.running import files, study
from tests.helpers.small_multiverse import written_design

pytestmark = pytest.mark.slow


def _run(out: Path, *flags: str) -> Path:
    config = written_design(out.parent, further_seeds=[1])
    assert study("multiverse", "--config", config, "--out", out, *flags).code == 0
    return out


@pytest.fixture(scope="module")
def apart(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    root = tmp_path_factory.mktemp("apart")
    return [
        _run(root / "part-0", "--universes=as_written*"),
        _run(root / "part-1", "--universes=study*", "--name=another"),
    ]


def test_it_is_what_one_run_leaves(apart: list[Path], tmp_path: Path) -> None:
    done = study("join", *apart, "--out", tmp_path / "joined")
    assert (done.code, done.err) == (0, "")
    together = _run(tmp_path / "together")
    names = ("*.md", "*.json", "*.parquet", "figures/*")
    joined = {k: v for name in names for k, v in files(tmp_path / "joined", name).items()}
    assert joined == {k: v for name in names for k, v in files(together, name).items()}
    assert len(joined) > 10
    assert len(read(tmp_path / "joined").scored) == 4
    assert not read(tmp_path / "joined").repeats.empty
    assert study("verify", tmp_path / "joined").code == 0


def test_parts_must_fit(apart: list[Path], tmp_path: Path) -> None:
    def refused(*folders: Path) -> str:
        done = study("join", *folders, "--out", tmp_path / "out")
        assert (done.code, done.out) == (2, "")
        assert not (tmp_path / "out").exists()
        return done.err.strip()

    first, second = apart
    assert refused(first) == "error: join: got 1 results folder; give at least two"
    nothing = tmp_path / "nothing"
    assert refused(first, nothing).startswith(f"error: there is no study in '{nothing}'")

    other = Path(shutil.copytree(second, tmp_path / "other"))
    facts = read_json(other / "multiverse.json")
    facts["settings"]["train"]["steps"] += 1
    facts["choices"][1]["values"][1]["settings"]["mlp.loss"] = "nlll"
    facts["bases"].reverse()
    _write(other, facts)
    expected = "bases.(order), choices.loss.values.plain.settings.mlp.loss, settings.train.steps"
    assert refused(first, other) == f"error: join: {first} and {other} differ in {expected}"


def test_a_universe_may_be_in_both_parts_with_the_same_results(
    apart: list[Path], tmp_path: Path
) -> None:
    first, second = apart
    assert study("join", first, second, first, "--out", tmp_path / "joined").code == 0
    assert len(read(tmp_path / "joined").scored) == 4
    other = Path(shutil.copytree(first, tmp_path / "other"))
    results = read(other)
    results.cells.loc[results.cells["universe"] == "as_written", "mmd2"] += 1e-9
    write(results, other)
    checksums.seal(other, multiverse.present(other))
    done = study("join", first, second, other, "--out", tmp_path / "out")
    expected = f"join: {first} and {other} differ in the results of the universe as_written"
    assert (done.code, done.err.strip()) == (2, f"error: {expected}")
    cells = results.cells["model"] != "full_vae"
    write(replace(results, cells=results.cells[cells]), other)
    checksums.seal(other, multiverse.present(other))
    done = study("join", second, other, "--out", tmp_path / "out")
    assert "differ in their cells: only one has pusher/low/full_vae/seed-0" in done.err


def _write(folder: Path, facts: dict[str, Any]) -> None:
    write_json(folder / "multiverse.json", facts, sort_keys=False)
    checksums.seal(folder, multiverse.present(folder))


def test_a_damaged_part_is_named(apart: list[Path], tmp_path: Path) -> None:
    damaged = tmp_path / "damaged"
    shutil.copytree(apart[0], damaged)
    (damaged / "choices.md").write_text("all is well")
    done = study("join", damaged, apart[1], "--out", tmp_path / "out")
    assert done.code == 1
    assert done.err.startswith(f"error: damaged: {damaged / 'choices.md'}; restore it")
    assert not (tmp_path / "out").exists()
