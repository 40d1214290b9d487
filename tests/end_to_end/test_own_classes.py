"""A system without a scene, a model that breaks its contract, recordings that cannot be drawn."""

from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.helpers.reading import entities
from tests.helpers.running import SMALL, study

pytestmark = pytest.mark.slow
FLAGS = [
    *SMALL,
    "--plugins=[tests.helpers.bodiless]",
    "--grid.environments=[bodiless]",
    "--grid.models=[drift]",
]
CELL = "bodiless/low/drift/seed-0"


def _broken(*_: Any, **__: Any) -> None:
    raise ValueError("no such colour")


def test_a_system_without_a_scene(tmp_path: Path) -> None:
    done = study("all", *FLAGS, "--out", tmp_path)
    assert done.code == 0, done
    recordings = tmp_path / "recordings"
    forecast = entities(recordings / CELL / "forecast.rrd")
    assert any("/paths/" in entity for entity in forecast)
    assert not any("/scene" in entity for entity in forecast)
    assert not any("/scene" in entity for entity in entities(recordings / "bodiless" / "data.rrd"))
    latex = (tmp_path / "tables" / "outcomes_bodiless.tex").read_text()
    assert "50\\% a\\&b\\#c\\$d$|$" in latex
    assert "50% a&amp;b#c$d\\|" in (tmp_path / "tables" / "outcomes_bodiless.md").read_text()
    assert study("verify", tmp_path).code == 0

    done = study("portrait", *FLAGS, "--to", tmp_path / "page")
    assert done.code == 0, done
    page = (tmp_path / "page" / "README.md").read_text()
    assert "filmstrip" not in page
    assert "| f\\|_x | N&lt;&amp;> | push \\|\\*\\| 100% | -1 | 1 |" in page


def test_a_model_that_breaks_its_contract_fails_before_it_is_trained(tmp_path: Path) -> None:
    done = study("all", *FLAGS, "--grid.models=[drift, narrow]", "--out", tmp_path)
    assert done.code == 1
    assert done.err == ""
    fault = "CheckFailed: tests.helpers.bodiless.Narrow.sample returned [6, 5, 8, 1], "
    assert f"FAILED: {fault}wanted [6, 5, 8, 2]" in done.out
    rows = [line.split() for line in done.out.splitlines()]
    assert ["bodiless/low/narrow/seed-0", "failed"] in [row[:2] for row in rows if row]
    scores = pd.read_parquet(tmp_path / "scores.parquet")
    assert "drift" in set(scores.model)
    assert "narrow" not in set(scores.model)


@pytest.mark.parametrize("command", [["portrait", "faceless"], ["export", "faceless"], ["all"]])
def test_a_scene_that_cannot_be_read_is_named_before_any_work(
    command: list[str], tmp_path: Path
) -> None:
    pytest.importorskip("minari")
    to = ["--to", tmp_path / "to"] if len(command) == 2 else []
    done = study(*command, *FLAGS, "--grid.environments=[faceless]", *to, "--out", tmp_path / "out")
    assert done.code == 1
    fault = "tests.helpers.bodiless.Faceless.scene raised ValueError: "
    printed = done.out if command == ["all"] else done.err
    (line,) = {line for line in printed.splitlines() if fault in line and "FAILED c" not in line}
    assert "nowhere.xml" in line
    assert not (tmp_path / "to").exists()


def test_recordings_and_figures_that_cannot_be_drawn_keep_no_scores_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as context:
        context.setattr("study.stages.record.record_forecast", _broken)
        context.setattr("paper_figs.reliability.plot", _broken)
        done = study("all", *FLAGS, "--out", tmp_path)
    assert done.code == 1
    assert done.err == ""
    assert f"FAILED record {CELL}: ValueError: no such colour" in done.out
    assert "FAILED paper_figs.reliability could not draw (ValueError: no such colour" in done.out
    (row,) = (line.split() for line in done.out.splitlines() if line.split()[:1] == [CELL])
    assert len(row) > 2
    assert row[1] != "failed"
    scores = pd.read_parquet(tmp_path / "scores.parquet")
    assert {"drift", "oracle", "ensemble"} <= set(scores.model)
    assert "| failed |" not in (tmp_path / "tables" / "brier_bodiless.md").read_text()
    assert not (tmp_path / "recordings" / CELL).exists()
    assert (tmp_path / "weights" / f"{CELL}.safetensors").exists()
    verified = study("verify", tmp_path)
    assert "figures/reliability_bodiless.pdf is missing; " in verified.out
    assert verified.out.count("DIFFERS") == 1

    done = study("all", *FLAGS, "--out", tmp_path)
    assert done.code == 0, done
    assert (tmp_path / "recordings" / CELL / "forecast.rrd").exists()
    repeated = pd.read_parquet(tmp_path / "scores.parquet")
    pd.testing.assert_frame_equal(repeated, scores)
    assert study("verify", tmp_path).code == 0
