"""Whether results are what they say: a damaged, a missing, a forged file; and a cell run again."""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot
from matplotlib.image import imread, imsave

from study.common.files import same_bytes, write_json
from study.results import checksums
from study.results.verify import compare_files, compare_scores, why_other
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
    """The small study as it is shipped: without its work folder."""
    out = tmp_path_factory.mktemp("light") / "results"
    return Path(shutil.copytree(small, out, ignore=shutil.ignore_patterns("work")))


@pytest.fixture
def harmed(light: Path, tmp_path: Path) -> Path:
    """A copy, to be damaged."""
    return Path(shutil.copytree(light, tmp_path / "harmed"))


def test_what_is_whole_passes_with_no_work_folder(light: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in light.rglob("*")}
    done = study("verify", light, "--rerun", CELL)
    assert (done.code, done.err) == (0, "")
    lines = [line.split(maxsplit=2) for line in done.out.splitlines()]
    assert [(state, name) for state, name, _ in lines] == [
        ("ok", name) for name in ("files", "recordings", "claims", "tables", "figures", "scores")
    ]
    assert lines[-1][2].endswith("evaluated again: the same numbers")
    assert {path: path.stat().st_mtime_ns for path in light.rglob("*")} == before


def test_other_programs_can_read_the_checksums(light: Path) -> None:
    command = ["sha256sum", "--check", "--quiet", checksums.NAME]
    assert subprocess.run(command, cwd=light, check=False).returncode == 0
    there = {p.relative_to(light).as_posix() for p in light.rglob("*") if p.is_file()}
    assert set(checksums.read(light)) == there - {checksums.NAME, ".lock"}


@pytest.mark.parametrize(
    ("name", "harm", "said"),
    [
        ("scores.parquet", flip, "damaged"),
        ("trials.parquet", flip, "damaged"),
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
def test_a_harmed_file_is_named(
    harmed: Path, name: str, harm: Callable[[Path], object], said: str
) -> None:
    assert checksums.problems(harmed) == []
    harm(harmed / name)
    assert checksums.problems(harmed) == [f"{said}: {harmed / name}"]


def test_a_file_that_is_not_the_studys(harmed: Path) -> None:
    add_one(harmed / "tables" / "brier_cart.md")
    (harmed / "notes.md").write_text("whoever likes may leave notes beside the results")
    (harmed / "tables" / ".hidden").touch()
    (line,) = checksums.problems(harmed)
    assert line == f"not listed in SHA256SUMS: {harmed / 'tables' / 'another.md'}"


def test_harm_is_told_and_the_rest_is_checked(harmed: Path) -> None:
    recording = harmed / "recordings" / CELL / "scores.rrd"
    flip(recording)
    flip(harmed / "scores.parquet")
    done = study("verify", harmed)
    assert (done.code, done.err) == (1, "")
    lines = done.out.splitlines()
    assert [line.split()[:2] for line in lines] == [
        ["DIFFERS", name] for name in ("files", "files", "recordings", "figures")
    ]
    assert f"damaged: {recording}" in lines[0]
    assert f"damaged: {harmed / 'scores.parquet'}" in lines[1]
    assert "not drawn again" in lines[3]


def test_what_is_forged_with_its_checksum_differs_from_the_scores(harmed: Path) -> None:
    change_score(harmed)
    table = harmed / "tables" / "outcomes_cart.md"
    table.write_text(table.read_text().replace("0.", "1.", 1))
    checksums.write(harmed)
    done = study("verify", harmed, "--rerun", "cart/low/drift/seed-0")
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
    assert "the same numbers" in done.out


@pytest.mark.parametrize("name", ["SHA256SUMS", "timings.json"])
def test_they_are_written_again(copied: Path, name: str) -> None:
    (copied / name).unlink()
    planned = study("plan", *SMALL, "--out", copied).out.splitlines()[-1]
    assert planned == f"0 of 14 stages to run; results: missing: {copied / name}"
    assert study("all", *SMALL, "--out", copied).code == 0
    assert checksums.problems(copied) == []
    assert study("plan", *SMALL, "--out", copied).out.splitlines()[-1].endswith("up to date")


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["no_such"], 2, "there is no study in 'no_such'"),
        ([".", "--rerun", "x"], 2, "there is no study in '.'"),
        (["OUT", "--rerun", "cart/low/full_va/seed-0"], 2, f"did you mean '{CELL}'?"),
        (["OUT", "--only", "cart/*"], 2, "verify has no '--only'"),
        (["OUT", "--rerun"], 2, "its value is missing"),
    ],
)
def test_one_line_about_what_cannot_be(
    light: Path, arguments: list[str], code: int, said: str
) -> None:
    done = study("verify", *(str(light) if a == "OUT" else a for a in arguments))
    assert done.code == code
    assert said in done.err
    assert done.err.count("\n") == 1


@pytest.mark.parametrize("text", ["{", "{}", '{"format": 1, "settings": 7}'])
def test_a_damaged_study(harmed: Path, text: str) -> None:
    (harmed / "study.json").write_text(text)
    done = study("verify", harmed)
    assert done.code == 1
    assert f"{harmed / 'study.json'} is damaged" in done.err
    assert done.err.count("\n") == 1


def test_a_study_with_a_setting_that_is_gone(harmed: Path) -> None:
    (harmed / "study.json").write_text('{"format": 1, "settings": {"nam": "x"}}')
    done = study("verify", harmed)
    assert done.code == 2
    assert "made by another version, which had a setting 'nam'; make it again" in done.err
    assert done.err.count("\n") == 1


def test_a_study_of_another_version(harmed: Path) -> None:
    path = harmed / "study.json"
    path.write_text(path.read_text().replace('"format": 1', '"format": 0'))
    done = study("verify", harmed)
    assert done.code == 2
    assert "made by another version (format 0, this one reads 1)" in done.err


def test_a_figure_in_other_bytes_is_the_same_picture(light: Path, tmp_path: Path) -> None:
    for name in ("one", "other"):
        shutil.copytree(light / "figures", tmp_path / name / "figures")
    picture = tmp_path / "other" / "figures" / "mmd_cart.png"
    imsave(picture, imread(picture))
    assert picture.read_bytes() != (light / "figures" / "mmd_cart.png").read_bytes()
    found = compare_files("figures", tmp_path / "one", tmp_path / "other", "figures/*")
    assert found.ok
    assert found.text.endswith("or of 1 the same content")
    pixels = np.array(imread(picture))
    pixels[0, 0, 0] = 1 - pixels[0, 0, 0]
    imsave(picture, pixels)
    found = compare_files("figures", tmp_path / "one", tmp_path / "other", "figures/*")
    assert not found.ok
    assert "of its pixels" in found.text


def test_claims_in_other_bytes_say_the_same(tmp_path: Path) -> None:
    ours, theirs = (tmp_path / name / "claims.json" for name in ("ours", "theirs"))

    def compared(claims: object) -> bool:
        write_json(theirs, claims)
        assert not same_bytes(ours, theirs)
        return compare_files("claims", ours.parent, theirs.parent, "claims.*").ok

    claim: dict[str, object] = {
        "text": "the first is lower",
        "findings": [{"effect": 0.3, "seeds": 2}],
    }
    write_json(ours, [claim])
    assert compared([claim | {"findings": [{"effect": 0.3 * (1 + 1e-13), "seeds": 2}]}])
    assert not compared([claim | {"findings": [{"effect": 0.3 * (1 + 1e-6), "seeds": 2}]}])
    assert not compared([claim | {"findings": [{"effect": 0.3, "seeds": 3}]}])
    assert not compared([claim | {"text": "the second is lower"}])
    assert not compared([claim, claim])
    assert not compared([{"text": claim["text"]}])
    ours.write_text("[")
    assert why_other(ours, theirs) == "is no JSON any more"


def test_a_pdf_in_other_bytes_is_the_same_picture(tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.pdf" for name in ("packed", "repacked", "another")]
    for path, level, height in zip(paths, (9, 1, 9), (1.0, 1.0, 1.1), strict=True):
        with pyplot.rc_context({"pdf.compression": level}):
            figure, axes = pyplot.subplots()
            axes.plot(np.sin(np.arange(300.0)) * height)
            figure.savefig(path, metadata={"CreationDate": None})
            pyplot.close(figure)
    assert paths[0].read_bytes() != paths[1].read_bytes()
    assert why_other(paths[0], paths[1]) is None
    assert why_other(paths[0], paths[2]) is not None


def table(values: list[float]) -> pd.DataFrame:
    """A score of everything, then scores of single scenarios."""
    scenario = np.arange(len(values)) - 1
    return pd.DataFrame(
        {"metric": "brier", "dimension": "all", "step": -1, "scenario": scenario, "value": values}
    )


def test_how_far_apart_scores_may_be() -> None:
    values = [0.25, *([0.5] * 199)]
    stored = table(values)
    assert compare_scores("cell", stored, table(values)).ok
    assert (
        "largest difference 0.0009" in compare_scores("", stored, table([0.2509, *values[1:]])).text
    )
    assert compare_scores("", stored, table([0.2509, *values[1:]])).ok
    assert not compare_scores("", stored, table([0.2512, *values[1:]])).ok
    assert compare_scores("", stored, table([0.25, 0.7, *values[2:]])).ok
    assert not compare_scores("", stored, table([0.25, 0.7, 0.7, 0.7, *values[4:]])).ok
    assert not compare_scores("", stored, table([np.nan, *values[1:]])).ok
    assert not compare_scores("", stored, table(values[:-1])).ok
    lost = table([np.inf, np.nan, *values[2:]])
    assert compare_scores("", lost, lost.copy()).ok
