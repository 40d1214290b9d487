"""Damaged files are found, named and written again, and no other files are."""

from collections.abc import Callable
from pathlib import Path

import pytest

from study.recording.integrity import check
from tests.helpers.reading import entities
from tests.helpers.running import SMALL, published, results, study

Find = Callable[[str], Path]


def _flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)


def _truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.mark.parametrize(
    ("name", "harm"),
    [
        ("work/collect/*/test.safetensors", _truncate),
        ("work/tune/*/journal.log", _flip),
        ("work/tune/*/manifest.json", _truncate),
        ("work/ensemble/*/ensemble.safetensors", _flip),
        ("work/ensemble/*/metrics.csv", Path.unlink),
        ("work/record_data/*/data.rrd", _flip),
    ],
)
def test_an_artifact(
    copied: Path, small: Path, only: Find, name: str, harm: Callable[[Path], None]
) -> None:
    path = only(name)
    harm(path)
    stage = path.parts[-3]
    (due,) = study("plan", *SMALL, "--out", copied).due().items()
    assert due[0].startswith(stage)
    assert due[1] == f"damaged: {path}"
    done = study("all", *SMALL, "--out", copied)
    assert done.code == 0
    assert f"{due[0]}: damaged: {path}; it runs again\n" in done.out
    assert "\n[1/1] " in done.out
    assert study("plan", *SMALL, "--out", copied).due() == {}
    assert results(copied) == results(small)


@pytest.mark.parametrize(
    ("name", "harm"),
    [
        ("scores.parquet", _flip),
        ("claims.json", Path.unlink),
        ("study.json", _truncate),
        ("tables/brier_cart.md", _flip),
        ("figures/mmd_cart.png", _truncate),
        ("recordings/cart/low/full_vae/seed-0/forecast.rrd", _flip),
        ("recordings/cart/low/full_vae/seed-0/tuning.rrd.sha256", Path.unlink),
        ("recordings/cart/data.rrd", _flip),
        ("recordings/study.rrd", _flip),
        ("recordings/study.rrd", _truncate),
        ("recordings/study.rrd", Path.unlink),
        ("recordings/study.rrd.sha256", Path.unlink),
        ("weights/cart/low/drift/seed-0.safetensors", _truncate),
        ("work/summary.json", _truncate),
    ],
)
def test_a_result(copied: Path, small: Path, name: str, harm: Callable[[Path], None]) -> None:
    harm(copied / name)
    planned = study("plan", *SMALL, "--out", copied)
    assert planned.due() == {}
    assert planned.out.splitlines()[-1].startswith("0 of 14 stages to run; results: ")
    assert name == "work/summary.json" or str(copied / name) in planned.out
    done = study("all", *SMALL, "--out", copied)
    assert done.code == 0
    assert f"{copied}: no stage to run, results written again\n" in done.out
    assert results(copied) == results(small)
    assert published(copied).keys() == published(small).keys()
    check(copied / "recordings" / "study.rrd")
    check(copied / "recordings" / "cart" / "data.rrd")
    assert study("plan", *SMALL, "--out", copied).out.endswith("results: up to date\n")


def test_results_of_cells_that_leave_the_grid_are_removed(copied: Path) -> None:
    done = study("all", *SMALL, "--out", copied, "--grid.models", "[drift]")
    assert done.code == 0
    assert not [name for name in published(copied) if "full_vae" in name]
    curves = entities(copied / "recordings" / "study.rrd")
    assert [name for name in curves if "drift" in name]
    assert not [name for name in curves if "full_vae" in name]
    restored = study("all", *SMALL, "--out", copied)
    assert restored.out.startswith(f"{copied}: no stage to run, results written again\n")
    assert [name for name in published(copied) if "full_vae" in name]
