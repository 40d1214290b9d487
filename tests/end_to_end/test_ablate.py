"""One choice changed at a time, compared on validation data."""

from pathlib import Path

import pytest

from study.common.files import read_json
from tests.helpers.running import SMALL, study

CHANGES = "--ablations=[vae.decoder_output=mean, vae.latent_size=1 vae.teacher_forcing=never]"


@pytest.mark.slow
def test_a_table_of_changes(tmp_path: Path) -> None:
    given = ("ablate", *SMALL, CHANGES, "--out", tmp_path / "out")
    done = study(*given)
    assert done.code == 0, done
    page = (tmp_path / "out" / "README.md").read_text()
    rows = [line.split(" | ") for line in page.splitlines() if line.startswith("| `")]
    assert [row[0] for row in rows] == [
        "| `vae.decoder_output=mean`",
        "| `vae.latent_size=1 vae.teacher_forcing=never`",
    ]
    # `drift` has no setting of the VAEs: it is fitted once, and shown in the first row alone.
    assert all(row[2].startswith("–") for row in rows)
    facts = read_json(tmp_path / "out" / "ablations.json")
    name = "cart/low/full_vae/seed-0"
    scores = {change: cells[name]["mmd2"] for change, cells in facts["scores"].items()}
    assert len(set(scores.values())) == 3
    for (_, entry, _), value in zip(rows, list(scores.values())[1:], strict=True):
        assert entry.startswith(f"**{value:.3f}**")
    stages = [path.parent.name for path in (tmp_path / "out/work").glob("*/*") if path.is_dir()]
    assert {stage: stages.count(stage) for stage in ("collect", "train", "validate")} == {
        "collect": 1,
        "train": 4,
        "validate": 4,
    }
    assert "evaluate" not in stages
    repeated = study(*given)
    assert repeated.code == 0
    assert "to run" not in repeated.out
    assert (tmp_path / "out" / "README.md").read_text() == page


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        ([], "nothing to change"),
        (["--ablations=[vae.decoder_outpt=mean]"], "did you mean 'vae.decoder_output'?"),
        (
            ["--ablations=[vae.decoder_output=men]"],
            "'vae.decoder_output=men': vae.decoder_output: got 'men'",
        ),
        (
            ["--ablations=[vae.decoder_output=mean, vae.decoder_output=mean]"],
            "each value may stand there once",
        ),
        (["--ablations=[vae.decoder_output]"], "vae.decoder_output: its value is missing"),
    ],
)
def test_what_cannot_be_changed(flags: list[str], expected: str, tmp_path: Path) -> None:
    done = study("ablate", *SMALL, *flags, "--out", tmp_path / "out")
    assert done.code == 2
    assert expected in done.err
    assert done.err.count("\n") == 1
    assert not (tmp_path / "out").exists()
