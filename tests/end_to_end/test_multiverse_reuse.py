"""A multiverse that takes the results of universes from another one."""

import copy
import shutil
from pathlib import Path
from typing import Any

import pytest

from study.common.files import read_json, write_json
from study.multiverse.folder import FACTS, read
from study.results import checksums, multiverse
from study.results.multiverse import is_own
from tests.helpers.running import Done, files, study
from tests.helpers.small_multiverse import DESIGN, written_design

pytestmark = pytest.mark.slow
OLD = ["study", "as_written", "study/loss=plain", "as_written/loss=plain"]
NEW = ["study/loss=wide", "as_written/loss=wide"]
SEEDS = [1]


def wider(folder: Path) -> Path:
    """The design with a further value."""
    choice = copy.deepcopy(DESIGN["choices"]["loss"])
    choice["values"]["wide"] = {"mlp.hidden_size": 6}
    return written_design(folder, SEEDS, loss=choice)


def run(config: Path, out: Path, *flags: Any) -> Done:
    return study("multiverse", "--config", config, "--out", out, *flags)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Published results without stages, and a run of the wider design with all its stages."""
    root = tmp_path_factory.mktemp("reuse")
    assert run(written_design(root, SEEDS), root / "together").code == 0
    ignored = shutil.ignore_patterns("work")
    published = Path(shutil.copytree(root / "together", root / "published", ignore=ignored))
    assert run(wider(root), root / "together").code == 0
    return published, root / "together"


@pytest.fixture
def published(folders: tuple[Path, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(folders[0], tmp_path / "published"))


@pytest.fixture(scope="module")
def mine(folders: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the wider design with the published results."""
    root = tmp_path_factory.mktemp("mine")
    done = run(wider(root), root / "out", "--reuse", folders[0])
    assert done.code == 0
    assert f"2 universes of 6 in the design; 4 are taken from {folders[0]}" in done.out
    return root / "out"


def change(folder: Path, **facts: Any) -> None:
    """Replace entries of ``multiverse.json``."""
    write_json(folder / FACTS, read_json(folder / FACTS) | facts, sort_keys=False)
    checksums.seal(folder, multiverse.present(folder))


def test_only_what_is_new_runs(folders: tuple[Path, Path], mine: Path) -> None:
    """The results are those of one run of everything."""
    # Two readings of the two VAEs, and the MLP with the further value.
    assert len(list((mine / "work" / "train").glob("*/manifest.json"))) == 2 * 2 + 1
    new, whole = read(mine), read(folders[1])
    assert new.scored == whole.scored == [*OLD[:3], NEW[0], OLD[3], NEW[1]]
    assert new.effects.equals(whole.effects)
    assert new.cells.equals(whole.cells)
    assert new.repeats.equals(whole.repeats)
    assert not new.repeats.empty
    assert new.facts["reused"] == {name: {} for name in OLD}
    text = "4 of them have results that were taken from another multiverse."
    assert text in (mine / "README.md").read_text(encoding="utf-8")
    assert study("verify", mine).code == 0


def test_the_plan(published: Path, tmp_path: Path) -> None:
    done = run(wider(tmp_path), tmp_path / "out", "plan", "--reuse", published)
    assert done.code == 0
    taken = [line.split()[0] for line in done.out.splitlines() if "taken from" in line]
    assert taken == OLD
    assert not (tmp_path / "out").exists()


def test_universes_are_found_by_their_settings(published: Path, mine: Path, tmp_path: Path) -> None:
    """The names of universes may differ, and the versions: these are recorded."""
    own = read(mine).facts["versions"]
    change(published, versions={**own, "python": "3.1"})
    config = wider(tmp_path)
    content = read_json(config)
    part = content["multiverse"]
    part["bases"] = {"first": {}, "second": {"forecast": "mean"}}
    part["choices"]["extra"] = {
        "question": "Which target?",
        "values": {"delta": {"vae.target": "delta"}, "state": {"vae.target": "state"}},
    }
    write_json(config, content, sort_keys=False)
    out = tmp_path / "out"
    assert run(config, out, "--reuse", published, "--universes=first").code == 0
    names = ["first", "second", "first/loss=plain", "second/loss=plain"]
    assert read(out).scored == names
    assert read(out).facts["reused"] == {name: {"python": "3.1"} for name in names}
    assert "another multiverse, made with python 3.1." in (out / "README.md").read_text()
    # What was taken twice keeps its versions.
    again = tmp_path / "again"
    assert run(config, again, "--reuse", out, "--universes=first").code == 0
    assert read(again).facts["reused"] == read(out).facts["reused"]


def test_what_was_taken_is_not_lost(folders: tuple[Path, Path], mine: Path, tmp_path: Path) -> None:
    out = Path(shutil.copytree(mine, tmp_path / "out"))
    assert not is_own(out)
    before = files(out)
    done = run(wider(tmp_path), out, "--universes=*wide")
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("error: --out: the results of study, as_written, study/loss=plain,")
    assert files(out) == before
    done = run(wider(tmp_path), out, "--reuse", folders[0])
    assert done.code == 0
    assert "(up to date)" in done.out


def test_what_has_run_here_is_preferred(folders: tuple[Path, Path], tmp_path: Path) -> None:
    published, together = folders
    out = Path(shutil.copytree(together, tmp_path / "out"))
    assert run(wider(tmp_path), out, "--reuse", published).code == 0
    assert "reused" not in read(out).facts
    assert is_own(out)


def test_what_cannot_be_reused(published: Path, tmp_path: Path) -> None:
    config, out = wider(tmp_path), tmp_path / "out"

    def refused(*flags: Any) -> str:
        done = run(config, out, *flags)
        assert (done.code, done.out) in [(2, ""), (1, "")]
        assert not out.exists()
        return done.err.strip().removeprefix("error: ")

    nothing = tmp_path / "nothing"
    assert refused("--reuse", nothing).startswith(f"there is no multiverse in {nothing}")
    expected = "--reuse: takes whole universes; leave out --only"
    assert refused("--reuse", published, "--only=*") == expected
    message = refused("--reuse", published, "--train.steps=3", "--mlp.layers=2")
    none = f"--reuse: no universe of {published} has the settings of one in this design"
    assert message == f"{none}; the first differs in mlp.layers, train.steps"
    assert refused("--reuse", published, "--grid.seeds=[2]").endswith("differs in their cells")
    change(published, failures=[_failure(name) for name in OLD])
    assert refused("--reuse", published) == none
    (published / "choices.md").write_text("all is well")
    assert refused("--reuse", published).startswith(f"damaged: {published / 'choices.md'}")


def _failure(universe: str) -> dict[str, str]:
    return {"universe": universe, "cell": "a", "stage": "train a", "error": "it broke"}
