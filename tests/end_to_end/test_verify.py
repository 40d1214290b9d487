"""Checks of a results folder: damaged, missing and forged files, and a cell evaluated again."""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from study.results import checksums
from tests.helpers.running import SMALL, study

CELL = "cart/low/full_vae/seed-0"


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)


def add_one(path: Path) -> None:
    path.with_name("another.md").write_text("forged")


def change_score(out: Path) -> None:
    """Change one score over all scenarios of a cell."""
    scores = pd.read_parquet(out / "scores.parquet")
    rows = scores[
        (scores.model == "drift")
        & (scores.metric == "brier")
        & (scores.scenario == -1)
        & (scores.step == 3)
    ]
    scores.loc[rows.index[0], "value"] += 0.01
    scores.to_parquet(out / "scores.parquet", index=False)


@pytest.fixture(scope="module")
def light(small: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small study without its work folder, as it is passed on."""
    out = tmp_path_factory.mktemp("light") / "results"
    return Path(shutil.copytree(small, out, ignore=shutil.ignore_patterns("work")))


@pytest.fixture
def damaged(light: Path, tmp_path: Path) -> Path:
    """A copy of it, to be damaged."""
    return Path(shutil.copytree(light, tmp_path / "damaged"))


def test_it_passes_without_a_work_folder(light: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in light.rglob("*")}
    done = study("verify", light, "--rerun", CELL)
    assert (done.code, done.err) == (0, "")
    lines = [line.split(maxsplit=2) for line in done.out.splitlines()]
    assert [(state, name) for state, name, _ in lines] == [
        ("ok", name) for name in ("files", "recordings", "claims", "tables", "figures", "scores")
    ]
    assert lines[-1][2].endswith("scores of a new evaluation, all the same numbers")
    assert {path: path.stat().st_mtime_ns for path in light.rglob("*")} == before


@pytest.mark.skipif(shutil.which("sha256sum") is None, reason="there is no sha256sum")
def test_other_programs_can_read_the_checksums(light: Path) -> None:
    command = ["sha256sum", "--check", "--quiet", checksums.NAME]
    assert subprocess.run(command, cwd=light, check=False).returncode == 0
    there = {p.relative_to(light).as_posix() for p in light.rglob("*") if p.is_file()}
    made_from_the_others = {"index.html"}  # the page
    assert set(checksums.read(light)) == there - {checksums.NAME, ".lock"} - made_from_the_others


@pytest.mark.parametrize(
    ("name", "damage", "problem"),
    [
        ("scores.parquet", flip, "damaged"),
        ("trials.parquet", flip, "damaged"),
        ("fits.parquet", flip, "damaged"),
        ("claims.json", flip, "damaged"),
        ("claims.md", Path.unlink, "missing"),
        ("timings.json", flip, "damaged"),
        ("study.json", flip, "damaged"),
        ("tables/brier_cart.md", flip, "damaged"),
        ("figures/mmd_cart.png", Path.unlink, "missing"),
        ("figures/mmd_cart.pdf", flip, "damaged"),
        (f"recordings/{CELL}/forecast.rrd", flip, "damaged"),
        (f"recordings/{CELL}/forecast.rrd.sha256", Path.unlink, "missing"),
        (f"weights/{CELL}.safetensors", flip, "damaged"),
        (f"weights/{CELL}.safetensors", Path.unlink, "missing"),
        ("SHA256SUMS", Path.unlink, "missing"),
        ("SHA256SUMS", lambda path: path.write_text("nonsense\n"), "damaged"),
    ],
)
def test_a_damaged_file_is_named(
    damaged: Path, name: str, damage: Callable[[Path], object], problem: str
) -> None:
    assert checksums.problems(damaged) == []
    damage(damaged / name)
    assert checksums.problems(damaged) == [f"{problem}: {damaged / name}"]


def test_a_file_that_is_not_of_the_study(damaged: Path) -> None:
    add_one(damaged / "tables" / "brier_cart.md")
    (damaged / "notes.md").write_text("notes beside the results")
    (damaged / "tables" / ".hidden").touch()
    (line,) = checksums.problems(damaged)
    assert line == f"not listed in SHA256SUMS: {damaged / 'tables' / 'another.md'}"


def test_damage_is_reported_and_the_rest_is_checked(damaged: Path) -> None:
    recording = damaged / "recordings" / CELL / "scores.rrd"
    flip(recording)
    flip(damaged / "scores.parquet")
    done = study("verify", damaged)
    assert (done.code, done.err) == (1, "")
    lines = done.out.splitlines()
    assert [line.split()[:2] for line in lines] == [
        ["DIFFERS", name] for name in ("files", "files", "recordings", "figures")
    ]
    assert f"damaged: {recording}" in lines[0]
    assert f"damaged: {damaged / 'scores.parquet'}" in lines[1]
    assert "not plotted again" in lines[3]


def test_a_forged_file_with_its_checksum_differs_from_the_scores(damaged: Path) -> None:
    change_score(damaged)
    table = damaged / "tables" / "outcomes_cart.md"
    table.write_text(table.read_text().replace("0.", "1.", 1))
    checksums.write(damaged)
    done = study("verify", damaged, "--rerun", "cart/low/drift/seed-0")
    assert done.code == 1
    found = {line.split()[1]: line for line in done.out.splitlines()}
    assert found["files"].startswith("ok")
    assert found["recordings"].startswith("ok")
    assert found["tables"].startswith("DIFFERS")
    assert found["scores"].startswith("DIFFERS")
    assert "metric brier" in found["scores"]
    assert "0.01" in found["scores"]


def test_with_a_work_folder_its_test_set_is_used(copied: Path) -> None:
    done = study("verify", copied, "--rerun", CELL)
    assert done.code == 0
    assert "all the same numbers" in done.out


@pytest.mark.parametrize("name", ["SHA256SUMS", "timings.json"])
def test_a_missing_file_is_written_again(copied: Path, name: str) -> None:
    (copied / name).unlink()
    planned = study("plan", *SMALL, "--out", copied).out.splitlines()[-1]
    assert planned == f"0 of 14 stages to run; results: missing: {copied / name}"
    assert study("all", *SMALL, "--out", copied).code == 0
    assert checksums.problems(copied) == []
    assert study("plan", *SMALL, "--out", copied).out.splitlines()[-1].endswith("up to date")


@pytest.mark.parametrize(
    ("arguments", "code", "expected"),
    [
        (["no_such"], 2, "there is no study in 'no_such'"),
        ([".", "--rerun", "x"], 2, "there is no study in '.'"),
        (["OUT", "--rerun", "cart/low/full_va/seed-0"], 2, f"did you mean '{CELL}'?"),
        (["OUT", "--only", "cart/*"], 2, "verify has no '--only'"),
        (["OUT", "--rerun"], 2, "its value is missing"),
    ],
)
def test_bad_input_gets_one_line(
    light: Path, arguments: list[str], code: int, expected: str
) -> None:
    done = study("verify", *(str(light) if a == "OUT" else a for a in arguments))
    assert done.code == code
    assert expected in done.err
    assert done.err.count("\n") == 1


@pytest.mark.parametrize("text", ["{", "{}", '{"format": 1, "settings": 7}'])
def test_a_damaged_study(damaged: Path, text: str) -> None:
    (damaged / "study.json").write_text(text)
    done = study("verify", damaged)
    assert done.code == 1
    assert f"{damaged / 'study.json'} is damaged" in done.err
    assert done.err.count("\n") == 1


def test_a_study_with_an_unknown_setting(damaged: Path) -> None:
    (damaged / "study.json").write_text('{"format": 1, "settings": {"nam": "x"}}')
    done = study("verify", damaged)
    assert done.code == 2
    assert "made by another version of the study: unknown setting 'nam'" in done.err
    assert done.err.count("\n") == 1


def test_a_study_of_another_version(damaged: Path) -> None:
    path = damaged / "study.json"
    path.write_text(path.read_text().replace('"format": 1', '"format": 0'))
    done = study("verify", damaged)
    assert done.code == 2
    assert "made by another version of the study (its format is 0, this version has 1)" in done.err
