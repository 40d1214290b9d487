"""Seeds: files and recordings hold them as 64-bit integers, so larger ones are refused first."""

from pathlib import Path

import pytest

from study.config.settings import LARGEST_SEED
from study.recording.tuning import record_tuning
from tests.helpers import reading, recordings
from tests.helpers.running import configuration, study


@pytest.mark.parametrize("setting", ["grid.seeds", "collect.seed"])
@pytest.mark.parametrize("seed", [-1, LARGEST_SEED + 1, 2**64, 10**30])
def test_a_seed_out_of_range_is_refused(setting: str, seed: int, tmp_path: Path) -> None:
    value = f"[{seed}]" if setting == "grid.seeds" else seed
    done = study("all", f"--{setting}", value, "--out", tmp_path / "new")
    assert done.code == 2
    assert done.err.startswith(f"error: {setting}: got {seed}; ")
    assert done.err.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_the_largest_seed_is_allowed_and_recorded(tmp_path: Path) -> None:
    config = configuration(f"--grid.seeds=[{LARGEST_SEED}]", f"--collect.seed={LARGEST_SEED}")
    assert config.grid.seeds == (LARGEST_SEED,)
    path = tmp_path / "tuning.rrd"
    record_tuning(path, recordings.trials(), {"seed": LARGEST_SEED})
    assert reading.properties(path)["seed"] == LARGEST_SEED
