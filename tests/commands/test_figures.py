"""Tables, figures and the page again: the checksums of everything else stay as they are."""

from pathlib import Path

import pytest

from study.workflow.lock import locked
from tests.helpers.running import files, study

SUMS = "SHA256SUMS"


def test_checksums_are_renewed(copied: Path) -> None:
    before = files(copied)
    table = next((copied / "tables").glob("*.md"))
    table.write_text("nothing\n")
    (copied / "figures" / "old.png").write_bytes(b"of an earlier version")
    (copied / "index.html").write_text("of an earlier version")
    assert study("figures", "--out", copied).code == 0
    assert files(copied) == before
    assert study("verify", copied).code == 0


def test_damage_elsewhere_stays_visible(copied: Path) -> None:
    weights = next((copied / "weights").rglob("*.safetensors"))
    weights.write_bytes(weights.read_bytes()[:-1])
    checksums = (copied / SUMS).read_bytes()
    assert study("figures", "--out", copied).code == 0
    assert (copied / SUMS).read_bytes() == checksums
    assert f"damaged: {weights}" in study("verify", copied).out


def test_damaged_scores_are_not_plotted(copied: Path) -> None:
    path = copied / "scores.parquet"
    path.write_bytes(path.read_bytes()[:-9])
    before = files(copied)
    done = study("figures", "--out", copied)
    assert done.code == 1
    assert f"{path} is damaged" in done.err
    assert files(copied) == before


@pytest.mark.slow
def test_a_folder_in_use(copied: Path) -> None:
    with locked(copied):
        before = files(copied)
        done = study("figures", "--out", copied)
        assert files(copied) == before
    assert done.code == 2
    assert f"{copied} is in use by process" in done.err


def test_without_scores_nothing_is_written(tmp_path: Path) -> None:
    done = study("figures", "--out", tmp_path)
    assert done.code == 2
    assert f"{tmp_path} has no scores.parquet" in done.err
    assert list(tmp_path.iterdir()) == []
