"""A missing or damaged file of a results folder is named, and the others are read."""

import re
from pathlib import Path

import pytest

from study.config.names import FULL
from study.page.evidence import read


def test_a_complete_folder_has_no_problems(published: Path) -> None:
    evidence = read(published)
    assert evidence.problems == []
    assert evidence.name == "known"
    assert evidence.recordings == [f"recordings/uav/low/{FULL}/seed-0/tuning.rrd"]
    assert evidence.engine == {"workers": 2}


@pytest.mark.parametrize(
    "name", ["study.json", "claims.json", "timings.json", "trials.parquet", "scores.parquet"]
)
@pytest.mark.parametrize("content", [None, b"", b"[1, 2", b"[3]", b"PAR1PAR1", b"\xff\xfe"])
def test_a_missing_or_damaged_file_is_named(copy: Path, name: str, content: bytes | None) -> None:
    (copy / name).unlink()
    if content is not None:
        (copy / name).write_bytes(content)
    evidence = read(copy)
    word = "missing" if content is None else "damaged"
    assert any(re.match(rf"{word}: {name}\b", problem) for problem in evidence.problems)
    assert not any(str(copy) in problem for problem in evidence.problems)
    assert (evidence.scores is None) == (name == "scores.parquet")
    assert (len(evidence.claims) == 0) == (name == "claims.json")


def test_a_changed_recording_is_named(copy: Path) -> None:
    path = copy / "recordings" / "uav" / "low" / FULL / "seed-0" / "tuning.rrd"
    path.write_bytes(path.read_bytes()[:-1])
    assert read(copy).problems == [f"damaged: {path.relative_to(copy)}"]
