"""A results folder of a multiverse without ``work/``: what a run may replace."""

import copy
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from study.common.errors import StudyError
from study.common.files import read_json, write_json
from study.multiverse.folder import FACTS, read
from study.results import multiverse as results
from study.results.multiverse import STATE, is_own
from study.stages import train
from tests.helpers.running import files, study
from tests.helpers.small_multiverse import DESIGN, written_design

pytestmark = pytest.mark.slow
SOME = ("--universes", "study*")
EVERYTHING = "study, as_written, study/loss=plain, as_written/loss=plain"
Refused = Callable[..., str]


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("multiverse")
    given = ("--config", written_design(folder), "--out", folder / "out")
    assert study("multiverse", *given).code == 0
    return folder / "out"


@pytest.fixture
def out(ran: Path, tmp_path: Path) -> Path:
    """The folder without its stages."""
    return Path(shutil.copytree(ran, tmp_path / "out", ignore=shutil.ignore_patterns("work")))


@pytest.fixture
def refused(out: Path, tmp_path: Path) -> Refused:
    """Run the command, which must be refused, and return what follows `--out: `."""

    def run(*flags: str, config: Path | None = None) -> str:
        before = files(out)
        given = ("--config", config or written_design(tmp_path), "--out", out)
        done = study("multiverse", *given, *flags)
        assert (done.code, done.out) == (2, "")
        assert files(out) == before
        message = done.err.strip()
        assert message.startswith("error: --out: ")
        assert message.endswith("; give another --out")
        return message.removeprefix("error: --out: ").removesuffix("; give another --out")

    return run


def _lost(names: str, out: Path, *settings: str) -> str:
    reason = f" (settings differ: {', '.join(settings)})" if settings else ""
    return f"the results of {names} would be lost, since {out} has no work/ of them{reason}"


def test_a_part_of_its_universes_does_not_replace_it(out: Path, refused: Refused) -> None:
    assert refused(*SOME) == _lost("as_written, as_written/loss=plain", out)
    assert refused("--only=*/residual_vae/*") == _lost(EVERYTHING, out)


def test_other_settings_do_not_replace_it(out: Path, refused: Refused, tmp_path: Path) -> None:
    assert refused("--train.steps=3") == _lost(EVERYTHING, out, "train.steps")
    choice = copy.deepcopy(DESIGN["choices"]["loss"])
    choice["values"]["plain"]["mlp.layers"] = 2
    changed = written_design(tmp_path, loss=choice)
    plain = "study/loss=plain, as_written/loss=plain"
    assert refused(config=changed) == _lost(plain, out, "mlp.layers")
    # A base reading of the same name with another value.
    facts = read_json(out / FACTS)
    for universe in facts["universes"]:
        if universe["name"] == "as_written":
            universe["values"]["loss"] = "plain"
    write_json(out / FACTS, facts)
    assert refused() == _lost("as_written", out, "mlp.loss")


def test_all_of_its_universes_replace_it(out: Path, tmp_path: Path) -> None:
    old = read(out)
    extra: dict[str, Any] = {
        "question": "Which target?",
        "values": {"delta": {"vae.target": "delta"}, "state": {"vae.target": "state"}},
    }
    wider = written_design(tmp_path, further_seeds=[1], extra=extra)
    assert study("multiverse", "--config", wider, "--out", out, "--name=other").code == 0
    assert set(read(out).scored) == {*old.scored, "study/extra=state", "as_written/extra=state"}
    assert is_own(out)
    # From now on the folder has the stages of its results, so a part of them may run.
    given = ("multiverse", "--config", written_design(tmp_path), "--out", out)
    assert study(*given, *SOME, "--train.steps=3").code == 0
    assert read(out).scored == ["study", "study/loss=plain"]


def test_a_run_that_fails_does_not_replace_it(
    out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any) -> None:
        raise FloatingPointError("the loss is not finite")

    monkeypatch.setattr(train, "run", fail)
    before = files(out)
    given = ("multiverse", "--config", written_design(tmp_path), "--out", out)
    done = study(*given)
    assert done.code == 1
    assert f"FAILED the results are not published: {_lost(EVERYTHING, out)}" in done.out
    after = files(out)
    assert {name: after[name] for name in before} == before
    monkeypatch.undo()
    assert study(*given).code == 0
    assert is_own(out)


def test_results_that_cannot_be_read_are_not_replaced(out: Path, refused: Refused) -> None:
    facts = read_json(out / FACTS)
    for damage in (facts | {"format": 1}, facts | {"settings": None}, None):
        write_json(out / FACTS, damage)
        message = refused(*SOME)
        assert message.startswith(f"the results in {out} would be lost, and cannot be read (")


def test_a_folder_that_was_replaced_is_not_its_own(ran: Path, tmp_path: Path) -> None:
    out = Path(shutil.copytree(ran, tmp_path / "out"))
    assert is_own(out)
    (out / "effects.parquet").write_bytes(b"of another machine")
    assert not is_own(out)


def test_a_figure_that_fails_leaves_it_its_own(
    ran: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = Path(shutil.copytree(ran, tmp_path / "out"))

    def fail(*_: Any) -> None:
        raise StudyError("a figure could not be drawn")

    monkeypatch.setattr(results, "_plot", fail)
    given = ("multiverse", "--config", written_design(tmp_path), "--out", out, *SOME)
    assert study(*given, "--mlp.layers=2").code == 1
    assert is_own(out)
    assert read_json(out / STATE)["inputs"] == ""
