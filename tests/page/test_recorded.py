"""What a page shows of recordings: scenarios with links, and the settings in which cells differ."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from study.config.names import FULL, MLP, RESIDUAL
from study.page import cell_settings, scenarios
from study.page.cell_settings import patterns
from study.page.evidence import read
from study.page.write import render_folder
from study.recording.forecast import record_forecast
from study.recording.scores import record_scores
from tests.helpers import recordings
from tests.helpers.synthetic import scores

CELL = f"uav/low/{RESIDUAL}/seed-0"
FORECAST = f"recordings/{CELL}/forecast.rrd"


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scores, the forecasts of one cell, and the recorded settings of three."""
    out = tmp_path_factory.mktemp("recorded") / "out"
    out.mkdir()
    scores(seeds=1).to_parquet(out / "scores.parquet")
    puck = recordings.Puck()
    first, second = recordings.examples(puck, 2)
    about = "Scenario 3 of the test set, chosen by this rule: *the <b>first</b>*."
    examples = [replace(first, description="A plan."), replace(second, description=about)]
    (out / FORECAST).parent.mkdir(parents=True)
    record_forecast(out / FORECAST, puck, examples, {"cell": CELL})
    for model, steps in ((RESIDUAL, 10), (FULL, 10), (MLP, 20)):
        settings = {"trained": {"train": {"steps": steps, "patience": 3}, "seed": steps}}
        path = out / f"recordings/uav/low/{model}/seed-0/scores.rrd"
        path.parent.mkdir(parents=True, exist_ok=True)
        record_scores(path, recordings.scores(), {"config": json.dumps(settings)})
    return out


def test_a_scenario_is_a_link_to_its_tab_with_its_scores(out: Path) -> None:
    table = scenarios.table(read(out))
    assert table is not None
    (row,) = table.rows
    assert row[0].links == [("best", f"{FORECAST}?tab=1")]
    assert [value.text for value in row[1:3]] == [CELL, "3"]
    rows = scores(seeds=1)
    rows = rows[(rows.environment == "uav") & (rows.level == "low") & (rows.model == RESIDUAL)]
    rows = rows[(rows.scenario == 3) & (rows.step == -1) & (rows.dimension == "all")]
    for value, metric in zip(row[3:], ("mmd2", "brier"), strict=True):
        assert value.order == pytest.approx(rows.loc[rows.metric == metric, "value"].item())
        assert value.trace == f"{CELL}, scenario 3\nscores.parquet: metric = {metric}"
    assert table.csv.count("best") == 1, "a link has its text in the file"


def test_settings_that_differ_and_those_that_do_not(out: Path) -> None:
    table = cell_settings.table(read(out))
    assert table is not None
    assert [[value.text for value in row] for row in table.rows] == [
        ["trained.train.steps", "10", f"*/*/{FULL}/*, */*/{RESIDUAL}/*"],
        ["trained.train.steps", "20", f"*/*/{MLP}/*"],
    ]
    assert "3 cells" in table.notes[0]


def test_patterns_match_the_cells_alone() -> None:
    every = [f"{e}/{level}/vae/seed-{s}" for e in "ab" for level in ("low", "high") for s in (0, 1)]
    assert patterns(every, every) == ["*/*/*/*"]
    assert patterns([every[0]], every) == ["a/low/*/seed-0"]
    assert patterns([*every[:4], every[4]], every) == ["a/*/*/*", "*/low/*/seed-0"]


def test_a_damaged_recording_is_left_out(out: Path) -> None:
    path = out / FORECAST
    content = path.read_bytes()
    path.write_bytes(b"RRF2 and no more")
    try:
        assert scenarios.table(read(out)) is None
        assert f'href="{FORECAST}"' in render_folder(out), "the other sections are there"
    finally:
        path.write_bytes(content)
