"""The lines of `plan`."""

from pathlib import Path

from tests.helpers.running import SMALL, study


def test_columns_are_aligned_with_long_names(tmp_path: Path) -> None:
    """The names of trials are longer than those of cells."""
    flags = ["--tune.trials=4", "--tune.batch=2", "--workers", "2"]
    lines = study("plan", *SMALL, *flags, "--out", tmp_path).out.splitlines()
    states = [line for line in lines if line.endswith(" missing") and "stages to run" not in line]
    assert any("/trial-3 " in line for line in states)
    assert len({line.rindex(" missing") for line in states}) == 1
    path = lines[next(n for n, line in enumerate(lines) if line.startswith("critical path")) + 1 :]
    durations = [len(line) - len(" ".join(line.split()[2:])) for line in path]
    assert any("/trial-" in line for line in path)
    assert len(set(durations)) == 1
