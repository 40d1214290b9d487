"""A study of toy size as a user runs it, once more without changes, and with one change."""

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet
import pytest
from safetensors.numpy import load_file

from study.common.files import read_json
from study.config.grid import REFERENCES, Cell, cells
from study.config.names import label
from study.models.checkpoints import load_model
from study.recording.integrity import check
from tests.helpers.reading import document, properties
from tests.helpers.running import SMALL, SMOKE, Done, configuration, files, published, study
from tests.recording.test_study import same_numbers

GRID = cells(configuration(*SMOKE))
MODELS = [cell for cell in GRID if not cell.is_reference]
VAES = [cell for cell in GRID if cell.model.endswith("vae")]
LINE = re.compile(
    r"66 stages to run, \d+ at a time; results in .*"
    r"|\[\d+/66\] (collect|record_data|ensemble|tune|train|evaluate|record) +\S+  \d+\.\d s"
    r"|(claims|tables|figures|recordings) +\S+"
    r"|  … .*"  # on a slow machine, a line every minute
)


def test_it_runs_and_says_so_in_plain_lines(smoke: tuple[Path, Done]) -> None:
    _, done = smoke
    assert done.code == 0
    assert done.err == ""
    said, table = done.out.split("smoke: MMD²")
    for line in said.strip().splitlines():
        assert LINE.fullmatch(line), line
    for cell in GRID:
        (row,) = [line for line in table.splitlines() if line.strip().startswith(cell.name)]
        assert "…" not in row
        assert "failed" not in row
    assert "\x1b" not in done.out


def test_scores_hold_every_cell(smoke: tuple[Path, Done]) -> None:
    out, _ = smoke
    scores = pd.read_parquet(out / "scores.parquet")
    columns = "environment level model seed metric dimension step scenario value"
    assert list(scores.columns) == columns.split()
    found = scores[["environment", "level", "model", "seed"]].drop_duplicates()
    assert {Cell(*row) for row in found.itertuples(index=False)} == set(GRID)
    overall = scores[(scores.dimension == "all") & (scores.step == -1) & (scores.scenario == -1)]
    for metric in ("mmd2", "brier"):
        values = overall[overall.metric == metric].value
        assert len(values) == len(GRID)
        assert np.isfinite(values).all()
    assert overall[overall.metric == "brier"].value.between(0, 1).all()
    mmd2 = overall[overall.metric == "mmd2"].set_index("model").value
    # Barely trained models differ from the system; the system does not differ from itself.
    assert mmd2["oracle"].max() < 0.2 < mmd2.drop(list(REFERENCES)).min()


def test_the_rest_of_the_results(smoke: tuple[Path, Done]) -> None:
    out, _ = smoke
    facts = read_json(out / "study.json")
    assert facts["settings"]["name"] == "smoke"
    assert facts["cells"] == [cell.name for cell in GRID]
    assert {"torch", "mujoco", "rerun-sdk", "python"} <= set(facts["versions"])
    claims = read_json(out / "claims.json")
    assert claims
    assert (out / "claims.md").read_text().startswith("#")
    for environment in ("pusher", "uav"):
        for suffix in ("md", "tex"):
            assert "esidual" in (out / f"tables/brier_{environment}.{suffix}").read_text()
        assert (out / f"figures/mmd_{environment}.png").read_bytes().startswith(b"\x89PNG")
        assert (out / f"figures/mmd_{environment}.pdf").read_bytes().startswith(b"%PDF")
    seconds = read_json(out / "timings.json")["seconds"]
    assert len(seconds) == 66
    assert min(seconds.values()) > 0


@pytest.mark.parametrize("cell", GRID, ids=lambda cell: cell.name)
def test_recordings_and_weights(smoke: tuple[Path, Done], cell: Cell) -> None:
    out, _ = smoke
    kinds = {"forecast", "scores"} | ({"training"} if cell.model != "oracle" else set())
    kinds |= {"tuning"} if cell in VAES else set()
    folder = out / "recordings" / cell.name
    assert {path.stem for path in folder.glob("*.rrd")} == kinds
    for kind in kinds:
        check(folder / f"{kind}.rrd")
    weights = out / "weights" / f"{cell.name}.safetensors"
    assert weights.exists() == (cell in MODELS)
    if cell in MODELS:
        model = load_model(weights)
        tensors = load_file(weights)
        size, pushes = len(tensors["state_mean"]), len(tensors["action_mean"])
        s0, actions = np.zeros((2, size), np.float32), np.zeros((2, 5, pushes), np.float32)
        forecast = model.forecast(s0, actions, 3, np.arange(2, dtype=np.uint64))
        assert forecast.shape == (2, 3, 5, size)
        assert np.isfinite(forecast).all()


def test_the_recording_of_the_whole_study(smoke: tuple[Path, Done]) -> None:
    out, _ = smoke
    path = out / "recordings" / "study.rrd"
    check(path)
    same_numbers(path, pd.read_parquet(out / "scores.parquet"))
    found = properties(path)
    assert found["study"] == "smoke"
    assert (
        json.loads(str(found["config"]))["tune"]
        == read_json(out / "study.json")["settings"]["tune"]
    )
    assert json.loads(str(found["versions"])) == read_json(out / "study.json")["versions"]
    folder = out / "recordings" / MODELS[0].name
    for kind in ("forecast", "training", "scores"):
        assert properties(folder / f"{kind}.rrd")["source_revision"] == found["source_revision"]
    about = [document(path, f"/text/{title}") for title in (r"Brier\ scores", "Claims", "Cells")]
    assert all(f"{label(name)} (lower" in about[0] for name in ("pusher", "uav"))
    assert about[1] == (out / "claims.md").read_text()
    assert all(cell.name in about[2] for cell in GRID)


def test_again_runs_nothing_and_changes_nothing(smoke: tuple[Path, Done]) -> None:
    out, _ = smoke
    before = files(out)
    repeated = study("all", *SMOKE, "--out", out)
    assert repeated.code == 0
    assert repeated.out.startswith(f"{out}: everything is up to date, nothing to run\n")
    assert files(out) == before


def test_plan_and_status_of_a_finished_study(smoke: tuple[Path, Done]) -> None:
    out, _ = smoke
    before = files(out)
    plan = study("plan", *SMOKE, "--out", out)
    assert plan.due() == {}
    assert plan.out.endswith("\n0 of 66 stages to run; results: up to date\n")
    status = study("status", *SMOKE, "--out", out)
    assert sum(" done " in line for line in status.out.splitlines()) == 66
    assert files(out) == before


def test_another_range_of_beta_runs_only_what_follows(smoke: tuple[Path, Done]) -> None:
    out, _ = smoke
    before = configuration(*SMOKE).tune.beta_high
    due = study("plan", *SMOKE, "--out", out, "--tune.beta_high", "50.0").due()
    stages = ("tune", "train", "evaluate", "record")
    assert set(due) == {f"{stage} {cell.name}" for stage in stages for cell in VAES}
    for name, why in due.items():
        expected = f"config changed: tune.beta_high {before} → 50.0"
        assert why == expected if name.startswith("tune") else why.startswith("input changed: ")


def test_a_part_of_the_grid(smoke: tuple[Path, Done]) -> None:
    out, _ = smoke
    plan = study("plan", *SMOKE, "--out", out, "--only", "uav/high/*", "--vae.latent_size", "3")
    assert set(plan.due()) == {
        f"{stage} {cell.name}"
        for stage in ("tune", "train", "evaluate", "record")
        for cell in VAES
        if cell.name.startswith("uav/high/")
    }


def test_figures_again_from_the_results_alone(smoke: tuple[Path, Done], tmp_path: Path) -> None:
    out, _ = smoke
    for copied in files(out, "*.parquet", "study.json", "illustrations/**/*"):
        (tmp_path / copied).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / copied).write_bytes((out / copied).read_bytes())
    done = study("figures", *SMOKE, "--out", tmp_path)
    assert done.code == 0
    plotted = {Path(line).relative_to(tmp_path) for line in done.out.splitlines()}
    written = ("tables", "figures", "claims")
    expected = {Path(name) for name in published(out) if name.startswith(written)}
    assert plotted == expected | {Path("index.html")}
    for name in expected:
        if name.parent.name != "figures":
            assert (tmp_path / name).read_bytes() == (out / name).read_bytes()


def test_the_parquet_file_is_plain(smoke: tuple[Path, Done]) -> None:
    out, _ = smoke
    schema = pyarrow.parquet.read_schema(out / "scores.parquet")
    assert {str(schema.field(name).type) for name in ("seed", "step", "scenario")} <= {
        "int32",
        "int64",
    }
    assert str(schema.field("value").type) == "double"


def test_weights_and_recordings_of_chosen_cells_are_published(copied: Path) -> None:
    """All scores stay. Errors name the cells that have weights. The choice can be undone."""
    first, other = "cart/low/full_vae/seed-0", "cart/low/drift/seed-0"
    before = published(copied)
    given = ("all", *SMALL, "--out", copied)
    done = study(*given, f"--publish.weights=[{first}]", f"--publish.recordings=[{first}]")
    assert done.code == 0
    now = published(copied)
    assert {name for name in now if name.startswith("weights")} == {f"weights/{first}.safetensors"}
    kinds = [Path(name).stem for name in now if name.startswith(f"recordings/{other}")]
    assert set(kinds) == {"forecast", "forecast.rrd"}
    assert now["scores.parquet"] == before["scores.parquet"]
    assert study("verify", copied, "--rerun", first).code == 0
    for asked in (
        ("verify", copied, "--rerun", other),
        (
            "forecast",
            "--cell",
            other,
            "--scenario",
            "0",
            "--out",
            copied,
            "--save",
            copied / "f.rrd",
        ),
    ):
        refused = study(*asked)
        assert refused.code == 1
        assert f"has no weights of '{other}'" in refused.out + refused.err
        assert first in refused.out + refused.err
    assert study(*given).code == 0
    assert published(copied).keys() == before.keys()


def test_scores_are_published_to_single_precision(smoke: tuple[Path, Done]) -> None:
    out, _ = smoke
    values = pd.read_parquet(out / "scores.parquet").value
    assert values.astype("float32").astype("float64").equals(values)


def test_only_chosen_forecast_recordings_are_published(copied: Path) -> None:
    """The others stay in work/. Nothing else changes, no stage runs, and it can be undone."""
    first, other = "cart/low/full_vae/seed-0", "cart/low/drift/seed-0"
    recordings, before = copied / "recordings", files(copied, "recordings/*/**/*", "weights/**/*")
    given = ("all", *SMALL, "--out", copied)
    done = study(*given, f"--publish.forecasts=[{first}]")
    assert done.code == 0
    assert "to run" not in done.out.replace("no stage to run", "")
    assert (recordings / first / "forecast.rrd").is_file()
    assert not list((recordings / other).glob("forecast.*"))
    assert (recordings / other / "scores.rrd").is_file()
    shown = study("view", other, *SMALL, "--out", copied)
    assert shown.code == 1
    assert f"forecast --cell {other} --scenario 0" in shown.err
    assert study("verify", copied).code == 0
    assert study(*given).code == 0
    assert files(copied, "recordings/*/**/*", "weights/**/*") == before
