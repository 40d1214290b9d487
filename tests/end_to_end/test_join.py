"""Seeds that were run apart, joined into one study."""

import shutil
from pathlib import Path

import pytest

from study.common.files import read_json, write_json
from study.results import checksums
from tests.helpers.running import SMALL, files, results, study

pytestmark = pytest.mark.slow
APART = ("[1]", "[0]")


def _run(out: Path, seeds: str) -> Path:
    flags = (*SMALL, '--publish.weights=["*/seed-0"]', f"--grid.seeds={seeds}")
    assert study("all", "--out", out, *flags).code == 0
    return out


@pytest.fixture(scope="module")
def apart(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    root = tmp_path_factory.mktemp("apart")
    return [_run(root / f"part-{number}", seeds) for number, seeds in enumerate(APART)]


def test_it_is_what_one_run_of_all_seeds_leaves(apart: list[Path], tmp_path: Path) -> None:
    done = study("join", *apart, "--out", tmp_path / "joined")
    assert (done.code, done.err) == (0, "")
    together = _run(tmp_path / "together", "[0, 1]")
    # Recordings have identifiers and times of their own. `verify` checks them.
    assert checksums.present(tmp_path / "joined") == checksums.present(together)
    joined = results(tmp_path / "joined") | files(tmp_path / "joined", "figures/*")
    assert len(joined) > 30
    assert joined == results(together) | files(together, "figures/*")
    assert study("verify", tmp_path / "joined").code == 0
    assert (tmp_path / "joined" / "index.html").is_file()
    timings = read_json(tmp_path / "joined" / "timings.json")
    assert (
        timings["seconds"].keys() == read_json(tmp_path / "together/timings.json")["seconds"].keys()
    )


def test_parts_must_fit(apart: list[Path], tmp_path: Path) -> None:
    def refused(*folders: Path, out: Path = tmp_path / "out") -> str:
        before = {folder: files(folder) for folder in folders}
        done = study("join", *folders, "--out", out)
        assert (done.code, done.out) == (2, "")
        assert {folder: files(folder) for folder in folders} == before
        assert out in before or not out.exists()
        return done.err.strip()

    first, second = apart
    assert refused(first) == "error: join: got 1 results folder; give at least two"
    assert refused(first, first) == f"error: join: {first} and {first} both have seed 1"
    exists = f"error: --out: '{second}' exists; give a folder that does not"
    assert refused(first, second, out=second) == exists

    other = tmp_path / "other"
    shutil.copytree(second, other)
    facts = read_json(other / "study.json")
    facts["settings"]["train"]["steps"] += 1
    facts["versions"]["torch"] = "0.1"
    write_json(other / "study.json", facts)
    expected = f"error: join: {first} and {other} differ in train.steps, versions.torch"
    assert refused(first, other) == expected


def test_a_damaged_part_is_named(apart: list[Path], tmp_path: Path) -> None:
    damaged = tmp_path / "damaged"
    shutil.copytree(apart[0], damaged)
    (damaged / "claims.md").write_text("all is well")
    done = study("join", damaged, apart[1], "--out", tmp_path / "out")
    assert done.code == 1
    assert done.err.startswith(f"error: damaged: {damaged / 'claims.md'}; restore it")
    assert not (tmp_path / "out").exists()
    assert not (tmp_path / ".out.new").exists()
