"""A multiverse that takes the results of universes from another one."""

import copy
import shutil
from pathlib import Path
from typing import Any

import pytest

from study.multiverse.folder import REUSED, read
from study.stages import train
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


@pytest.fixture(scope="module")
def mine(folders: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the wider design with the published results."""
    root = tmp_path_factory.mktemp("mine")
    done = run(wider(root), root / "out", "--reuse", folders[0])
    assert done.code == 0
    assert f"2 universes of 6 in the design; 4 are taken from {folders[0]}" in done.out
    return root / "out"


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
    assert new.facts[REUSED] == {name: {} for name in OLD}
    text = "The results of 4 universes were taken from another multiverse."
    assert text in (mine / "README.md").read_text(encoding="utf-8")
    assert study("verify", mine).code == 0


def test_the_plan(folders: tuple[Path, Path], tmp_path: Path) -> None:
    done = run(wider(tmp_path), tmp_path / "out", "plan", "--reuse", folders[0])
    assert done.code == 0
    taken = [line.split()[0] for line in done.out.splitlines() if "taken from" in line]
    assert taken == OLD
    assert not (tmp_path / "out").exists()


def test_what_was_taken_is_not_lost(folders: tuple[Path, Path], mine: Path, tmp_path: Path) -> None:
    out = Path(shutil.copytree(mine, tmp_path / "out"))
    before = files(out)
    done = run(wider(tmp_path), out, "--universes=*wide")
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("error: --out: the results of study, as_written, study/loss=plain,")
    assert files(out) == before
    done = run(wider(tmp_path), out, "--reuse", folders[0])
    assert done.code == 0
    assert "(up to date)" in done.out


def test_a_universe_that_fails_can_run_again(
    folders: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A failure is published, and the next run replaces it."""
    original = train.run

    def fail(settings: Any, *others: Any) -> None:
        if settings.model_settings.get("mlp", {}).get("hidden_size") == 6:
            raise FloatingPointError("the loss is not finite")
        original(settings, *others)

    monkeypatch.setattr(train, "run", fail)
    out, given = tmp_path / "out", ("--reuse", folders[0])
    for _ in range(2):
        done = run(wider(tmp_path), out, *given)
        assert done.code == 1
        assert "not published" not in done.out
        assert {failure.universe for failure in read(out).failures} == set(NEW)
    monkeypatch.undo()
    assert run(wider(tmp_path), out, *given).code == 0
    assert not read(out).failures
    assert read(out).effects.equals(read(folders[1]).effects)


def test_what_has_run_here_is_preferred(folders: tuple[Path, Path], tmp_path: Path) -> None:
    published, together = folders
    out = Path(shutil.copytree(together, tmp_path / "out"))
    done = run(wider(tmp_path), out, "--reuse", published)
    assert done.code == 0
    assert "taken" not in done.out
    assert REUSED not in read(out).facts


def test_what_cannot_be_reused(folders: tuple[Path, Path], tmp_path: Path) -> None:
    config, published = wider(tmp_path), folders[0]

    def refused(out: Path, *flags: Any) -> str:
        before = files(out)
        done = run(config, out, "--reuse", published, *flags)
        assert (done.code, done.out) == (2, "")
        assert files(out) == before
        return done.err.strip().removeprefix("error: --reuse: ")

    expected = "takes whole universes; leave out --only"
    assert refused(tmp_path / "out", "--only=*") == expected
    assert refused(published) == f"{published} is the results folder; give another --out"
    expected = f"no universe of {published} has the settings and cells of one in this design"
    message = refused(tmp_path / "out", "--train.steps=3")
    assert message == f"{expected}; 'study' differs in train.steps"
