"""With what results were made: noted by each task, joined, and compared with what is here."""

from pathlib import Path

import pytest
from safetensors import safe_open

from study.common.files import read_json, write_json
from study.common.provenance import versions
from study.config.grid import Cell
from study.results import folder, origin
from study.results.origin import DIGITS, Origin
from study.workflow import source
from tests.helpers.running import SMALL, study

CELL = Cell("cart", "low", "drift", 0)
VERSIONS = {"torch": "2.0", "numpy": "2.1"}


def test_parts_that_differ_stand_side_by_side() -> None:
    one = Origin(VERSIONS, "one processor", "cc 12", "1", {"a": "0"})
    other = Origin(VERSIONS | {"numpy": "2.2"}, "another", "cc 12", "2", {"a": "0", "b": "1"})
    joined = origin.join([one, other, one])
    assert joined.versions == {"torch": "2.0", "numpy": "2.1; 2.2"}
    assert joined.device == "another; one processor"
    assert (joined.compiler, joined.threads) == ("cc 12", "1; 2")
    assert joined.source == {"a": "0", "b": "1"}
    assert origin.from_json(origin.to_json(joined)) == joined


def test_an_earlier_version_has_versions_alone() -> None:
    found = origin.from_json({"versions": VERSIONS})
    assert found == Origin(VERSIONS)
    assert "it is unknown" in (found.changed_source([CELL]) or "")


def test_every_task_and_all_weights_say_with_what_they_were_made(small: Path) -> None:
    facts = read_json(small / "study.json")
    assert facts["versions"] == versions()
    assert facts["threads"] == "1"
    assert facts["device"]
    assert facts["compiler"]
    for path in small.glob("work/*/*/manifest.json"):
        runtime = read_json(path)["runtime"]
        assert runtime["versions"] == facts["versions"]
        assert {runtime[name] for name in ("device", "compiler")} == {
            facts[name] for name in ("device", "compiler")
        }
    with safe_open(small / "weights" / f"{CELL.name}.safetensors", framework="np") as file:
        assert '"runtime": {"compiler": ' in file.metadata()["facts"]


def test_results_name_what_made_them_and_not_what_publishes_them(
    copied: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = (copied / "study.json").read_bytes()
    monkeypatch.setattr("study.common.provenance.PACKAGES", ("numpy",))
    (copied / "claims.md").unlink()
    done = study("all", *SMALL, "--out", copied)
    assert "results written again" in done.out
    assert (copied / "study.json").read_bytes() == before


def test_other_source_of_a_model_is_said(copied: Path, tmp_path: Path) -> None:
    results = folder.read(copied)
    assert results.origin.changed_source(results.complete) is None
    facts = read_json(copied / "study.json")
    facts["source"]["study.examples.drift"] = "0" * DIGITS
    write_json(copied / "study.json", facts)
    changed = "the source has changed since these were made: study.examples.drift; scores may"
    other = Cell("cart", "low", "full_vae", 0)
    assert folder.read(copied).origin.changed_source([other]) is None
    given = ("forecast", "--scenario", 0, "--save", tmp_path / "a.rrd", "--out", copied)
    assert changed in study(*given, "--cell", CELL.name).out
    assert changed not in study(*given, "--cell", other.name).out
    assert changed in study("verify", copied).out


def test_the_source_is_that_of_the_tasks(small: Path) -> None:
    noted = read_json(small / "study.json")["source"]
    now = source.source_digests(("study.examples.drift", "study.examples.cart"))
    assert {name: noted[name] for name in now} == {n: d[:DIGITS] for n, d in now.items()}
