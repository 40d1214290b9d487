"""A small multiverse: what it writes, and which stages run after a change of its design."""

import copy
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from paper_figs import specification_curve
from study.commands.parser import parse
from study.commands.view import find_recording
from study.common.errors import StudyError
from study.common.files import read_checksums, read_json, sha256
from study.multiverse.effects import effects_of
from study.multiverse.folder import FILES, read
from study.recording.integrity import check
from study.stages import train
from tests.helpers.running import Done, files, study
from tests.helpers.small_multiverse import DESIGN, written_design


def loss(**values: Mapping[str, Any]) -> dict[str, Any]:
    """The choice `loss` with further or other values."""
    choice = copy.deepcopy(DESIGN["choices"]["loss"])
    choice["values"] |= values
    return {"loss": choice}


def folders(out: Path) -> set[Path]:
    """The folders of all complete stages."""
    return {path for path in (out / "work").glob("*/*") if (path / "manifest.json").is_file()}


def new_stages(before: set[Path], out: Path) -> dict[str, int]:
    """How many stages of each kind have run since."""
    new = [path.parent.name for path in folders(out) - before]
    return {stage: new.count(stage) for stage in new}


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Done]:
    """The results of the multiverse; tests only add to them."""
    folder = tmp_path_factory.mktemp("multiverse")
    out = folder / "out"
    done = study("multiverse", "--config", written_design(folder), "--out", out)
    assert done.code == 0, done
    return out, done


def again(out: Path, folder: Path, **choices: Mapping[str, Any]) -> Done:
    """Run a changed design in the folder of another."""
    return study("multiverse", "--config", written_design(folder, (), **choices), "--out", out)


@pytest.fixture
def copied(ran: tuple[Path, Done], tmp_path: Path) -> Path:
    return Path(shutil.copytree(ran[0], tmp_path / "out"))


@pytest.mark.slow
def test_universes_share_stages(ran: tuple[Path, Done]) -> None:
    out, _ = ran
    assert read(out).scored == ["study", "as_written", "study/loss=plain", "as_written/loss=plain"]
    # Two readings of the two VAEs, two of the MLP, and the oracle and the ensemble alone.
    assert new_stages(set(), out) == {
        "collect": 1,
        "ensemble": 1,
        "tune": 2 * 2,
        "train": 2 * 2 + 2,
        "evaluate": 2 * 2 + 2 + 2,
    }


@pytest.mark.slow
def test_the_effects_are_those_of_the_scores_of_the_universe(ran: tuple[Path, Done]) -> None:
    out, _ = ran
    results = read(out)
    scores = []
    for path in folders(out):
        facts = read_json(path / "manifest.json")
        if facts["stage"] == "evaluate" and _is_of_study(facts, out):
            environment, *rest = facts["label"].split("/")
            level, model, _ = rest if len(rest) == 3 else ("low", "oracle", "")
            table = pd.read_parquet(path / "scores.parquet")
            cell = {"environment": environment, "level": level, "model": model, "seed": 0}
            scores.append(table.assign(**cell))
    assert len(scores) == 5
    expected = effects_of("study", pd.concat(scores))
    found = results.effects[results.effects["universe"] == "study"].reset_index(drop=True)
    pd.testing.assert_frame_equal(found, expected)
    assert found["effect"].notna().any()


def _is_of_study(evaluation: Mapping[str, Any], out: Path) -> bool:
    """Whether a stage `evaluate` is of the base reading `study`, by the settings of its fit."""
    if "trained" not in evaluation["inputs"]:
        return True
    fit = out / "work" / "train" / evaluation["inputs"]["trained"][:16] / "manifest.json"
    settings = read_json(fit)["settings"]["model_settings"]
    output = settings.get("vae", {}).get("decoder_output", "sample")
    return (output, settings.get("mlp", {}).get("loss", "beta_nll")) == ("sample", "beta_nll")


@pytest.mark.slow
def test_the_files(ran: tuple[Path, Done]) -> None:
    out, done = ran
    sums = read_checksums(out / "SHA256SUMS")
    assert all(sha256(out / name) == value for name, value in sums.items())
    figures = {f"figures/{name}" for name in ("curves.pdf", "verdicts.png", "vae_scores.png")}
    assert {"README.md", "choices.md", *FILES, *figures} < set(sums)
    claim = "mmd-residual-lowest-pusher-low"
    assert f"figures/specification_{claim}.png" in sums
    check(out / "recordings" / "multiverse.rrd")
    assert "4 of 4 universes have scores" in done.out
    assert "No stage failed." in (out / "README.md").read_text()


@pytest.mark.slow
def test_a_second_run_runs_and_writes_nothing(copied: Path, tmp_path: Path) -> None:
    before = files(copied)
    done = again(copied, tmp_path)
    assert done.code == 0
    assert "to run" not in done.out
    assert "README.md  (up to date)" in done.out
    assert files(copied) == before


@pytest.mark.slow
def test_a_figure_that_fails_costs_no_other_file(
    copied: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: Path) -> None:
        raise StudyError("a figure could not be drawn")

    (copied / "README.md").write_text("nothing")
    monkeypatch.setattr(specification_curve, "plot", fail)
    done = again(copied, tmp_path)
    assert done.code == 1
    assert "FAILED a figure could not be drawn" in done.out
    checksums = read_checksums(copied / "SHA256SUMS")
    assert "recordings/multiverse.rrd" in checksums
    assert all(sha256(copied / name) == value for name, value in checksums.items())
    monkeypatch.undo()
    assert again(copied, tmp_path).code == 0
    assert any(name.startswith("figures/") for name in read_checksums(copied / "SHA256SUMS"))


@pytest.mark.slow
def test_a_damaged_page_is_written_again(copied: Path, tmp_path: Path) -> None:
    before = (copied / "README.md").read_bytes()
    (copied / "README.md").write_text("nothing")
    assert again(copied, tmp_path).code == 0
    assert (copied / "README.md").read_bytes() == before


@pytest.mark.slow
def test_it_is_verified(copied: Path) -> None:
    (copied / "notes.md").write_text("of a reader")
    done = study("verify", copied)
    assert done.code == 0, done
    checks = [line.split()[:2] for line in done.out.splitlines()]
    assert checks == [["ok", name] for name in ("files", "recordings", "tables", "figures")]
    (copied / "figures" / "verdicts.png").unlink()
    (copied / "choices.md").write_text("nothing")
    done = study("verify", copied)
    assert done.code == 1
    found = {line.split()[1] for line in done.out.splitlines() if line.startswith("DIFFERS")}
    assert found == {"files", "tables", "figures"}
    (copied / "effects.parquet").write_bytes(b"PAR1")
    done = study("verify", copied)
    assert done.code == 1
    last = (
        f"DIFFERS  figures    not made again, since a source is damaged: {copied}/effects.parquet"
    )
    assert done.out.splitlines()[-1] == last
    (copied / "multiverse.json").unlink()
    done = study("verify", copied)
    assert done.code == 1
    assert f"missing: {copied / 'multiverse.json'}" in done.out
    assert "is a multiverse" in study("verify", copied, "--rerun", "pusher").err


@pytest.mark.slow
def test_a_changed_value_runs_its_universes_alone(copied: Path, tmp_path: Path) -> None:
    before, old = folders(copied), read(copied)
    changed = loss(plain={"mlp.loss": "nll", "mlp.layers": 2})
    plan = study(
        "multiverse", "plan", "--config", written_design(tmp_path, **changed), "--out", copied
    )
    assert again(copied, tmp_path, **changed).code == 0
    # Both universes with the value have the same MLP.
    assert new_stages(before, copied) == {"train": 1, "evaluate": 1}
    lines = plan.out.splitlines()
    assert [line.split()[:2] for line in lines[2:4]] == [["study", "up"], ["as_written", "up"]]
    assert lines[4].split()[:3] == ["study/loss=plain", "2", "of"]
    assert lines[-1].startswith("2 of 20 stages to run (1 train, 1 evaluate): about ")
    new = read(copied)
    for name in old.scored:
        same = [table.effects[table.effects["universe"] == name] for table in (old, new)]
        assert same[0].reset_index(drop=True).equals(same[1].reset_index(drop=True)) is not (
            name.endswith("plain")
        )


@pytest.mark.slow
def test_a_further_value_runs_what_is_new_alone(copied: Path, tmp_path: Path) -> None:
    before = folders(copied)
    assert again(copied, tmp_path, **loss(wide={"mlp.hidden_size": 6})).code == 0
    assert new_stages(before, copied) == {"train": 1, "evaluate": 1}
    new = ["study/loss=wide", "as_written/loss=wide"]
    assert [name for name in read(copied).scored if "wide" in name] == new


@pytest.mark.slow
def test_further_seeds_of_the_base_readings_change_no_verdict(copied: Path, tmp_path: Path) -> None:
    before, old = folders(copied), read(copied)
    path = written_design(tmp_path, further_seeds=[1])
    plan = study("multiverse", "plan", "--config", path, "--out", copied, "--grid.seeds=[0, 1]")
    assert plan.code == 0  # a further seed may be one of the study
    assert study("multiverse", "--config", path, "--out", copied).code == 0
    # Two readings of the two VAEs, the MLP that both have, and the oracle and the ensemble alone.
    # The data do not depend on the training seed.
    expected = {"ensemble": 1, "tune": 2 * 2, "train": 2 * 2 + 1, "evaluate": 2 * 2 + 1 + 2}
    assert new_stages(before, copied) == expected
    new = read(copied)
    assert new.effects.equals(old.effects)
    assert new.cells.equals(old.cells)
    assert set(new.repeats["seed"]) == {1}
    assert list(dict.fromkeys(new.repeats["universe"])) == ["study", "as_written"]
    assert new.repeats["mmd2"].notna().all()
    assert "## Variation of training" in (copied / "README.md").read_text()


@pytest.mark.slow
def test_a_failed_universe_is_listed_and_stops_no_other(
    copied: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = train.run

    def fail(settings: Any, *others: Any) -> None:
        if settings.model_settings.get("mlp", {}).get("hidden_size") == 6:
            raise FloatingPointError("the loss is | not finite")
        run(settings, *others)

    monkeypatch.setattr(train, "run", fail)
    values = {"broken": {"mlp.hidden_size": 6}, "wide": {"mlp.hidden_size": 8}}
    done = again(copied, tmp_path, **loss(**values))
    assert done.code == 1
    assert "FAILED train pusher/low/probabilistic_mlp/seed-0: FloatingPointError" in done.out
    results = read(copied)
    assert {failure.universe for failure in results.failures} == {
        "study/loss=broken",
        "as_written/loss=broken",
    }
    row = "| `study/loss=broken` | pusher/low/probabilistic_mlp/seed-0 | train pusher/low/"
    page = (copied / "README.md").read_text()
    assert row in page
    assert "FloatingPointError: the loss is \\| not finite" in page
    effects = results.effects.set_index("universe")
    # The claim needs the MLP that failed; the other universes have it.
    claim = effects[effects["claim"] == "mmd-residual-lowest-pusher-low"]["effect"]
    assert claim[claim.index == "study/loss=broken"].isna().all()
    assert claim[claim.index == "study/loss=wide"].notna().all()

    monkeypatch.undo()
    before = folders(copied)
    repaired = again(copied, tmp_path, **loss(**values))
    assert repaired.code == 0
    assert new_stages(before, copied) == {"train": 1, "evaluate": 1}
    assert read(copied).failures == []


@pytest.mark.slow
def test_a_part_of_the_universes(tmp_path: Path) -> None:
    given = ("multiverse", "--config", written_design(tmp_path), "--out", tmp_path / "out")
    assert study(*given, "--universes", "study*").code == 0
    results = read(tmp_path / "out")
    assert results.scored == ["study", "study/loss=plain"]
    assert len(results.universes) == 4
    assert results.failures == []
    page = (tmp_path / "out" / "README.md").read_text()
    assert "2 of 4 universes have scores" in page


@pytest.mark.slow
def test_the_recording_is_found(ran: tuple[Path, Done], tmp_path: Path) -> None:
    out, _ = ran
    _, options = parse(["view", "multiverse", "--out", str(out)])
    assert find_recording(options) == out / "recordings" / "multiverse.rrd"
    done = study("view", "multiverse", "--out", tmp_path / "none")
    assert done.code == 1
    assert "python -m study.run multiverse writes it" in done.err
