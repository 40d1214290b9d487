"""What a clone can do with ``results/paper``, with nothing trained."""

from pathlib import Path

from study.models.checkpoints import load_model
from study.results import checksums, folder

PAPER = Path(__file__).parents[2] / "results" / "paper"
MEGABYTES = 60


def test_every_committed_model_can_be_loaded() -> None:
    study = folder.read(PAPER)
    cells = [cell for cell in study.complete if study.has_weights(cell)]
    assert cells
    for cell in cells:
        assert load_model(study.weights(cell)).state_size in (12, 17)


def test_every_file_has_its_checksum() -> None:
    assert not list(checksums.problems(PAPER))


def test_the_committed_results_are_small() -> None:
    files = [path for path in PAPER.rglob("*") if path.is_file() and "work" not in path.parts]
    assert sum(path.stat().st_size for path in files) < MEGABYTES * 1e6
