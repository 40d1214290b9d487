"""One choice changed at a time, compared on validation data alone."""

import json
from pathlib import Path

import pytest

from study.common.files import read_json
from study.common.progress import Progress
from study.examples.cart import Cart
from study.models.oracle import Oracle
from study.stages import collect, validate
from tests.helpers.running import SMALL, study

CHANGES = "--ablations=[vae.decoder_output=mean, vae.latent_size=1 vae.teacher_forcing=never]"


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
    # `drift` has no setting of the VAEs: it is fitted once, and told once.
    assert all(row[2].startswith("–") for row in rows)
    facts = read_json(tmp_path / "out" / "ablations.json")
    name = "cart/low/full_vae/seed-0"
    scores = {change: told[name]["mmd2"] for change, told in facts["scores"].items()}
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
    again = study(*given)
    assert again.code == 0
    assert "to run" not in again.out
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


def test_the_oracle_is_perfect_and_the_test_set_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    data.mkdir()
    out.mkdir()
    sizes = {"trajectories": 40, "validation": 400, "scenarios": 2, "rollouts": 2, "horizon": 20}
    settings = {"environment": "cart", "collect": sizes | {"reduction": 10, "seed": 0}}
    collect.run(settings, {}, data, Progress())
    (data / "test.safetensors").unlink()
    (tmp_path / "fit.json").write_text(json.dumps({"beta": 0.5}))
    monkeypatch.setattr(validate, "load_model", lambda _: Oracle(Cart(horizon=20)))
    inputs = {"data": data, "trained": tmp_path}
    validate.run({"environment": "cart", "seed": 3, "samples": 20}, inputs, out, Progress())
    found = read_json(out / "validation.json")
    assert found["beta"] == 0.5
    assert abs(found["mmd2"]) < 0.01
    assert found["brier_skill"] == pytest.approx(1.0, abs=0.15)
    assert found["variance_ratio"] == pytest.approx(1.0, abs=0.1)
