"""Forecasts with the weights of a study: of its test scenarios, or of a plan from a file."""

import json
import shutil
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from study.common.progress import Progress
from study.data.trajectories import ScenarioSet
from study.recording.integrity import check
from study.results import folder
from study.results.forecast import Request, forecast, outcome_probabilities, read_request
from tests.helpers.reading import entities, properties
from tests.helpers.running import Done, study

CELL = "uav/high/residual_vae/seed-0"


@pytest.fixture(scope="session")
def shipped(smoke: tuple[Path, Done], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The smoke study as a reader has it: without the work folder."""
    out = tmp_path_factory.mktemp("shipped") / "results"
    return Path(shutil.copytree(smoke[0], out, ignore=shutil.ignore_patterns("work")))


@pytest.mark.parametrize(
    "name",
    [
        CELL,
        "pusher/low/probabilistic_mlp/seed-0",
        "uav/low/ensemble/seed-0",
        "pusher/low/oracle/seed-0",
    ],
)
@pytest.mark.parametrize("scenario", [0, 5])
def test_they_are_the_forecasts_that_were_scored(shipped: Path, name: str, scenario: int) -> None:
    results = folder.read(shipped)
    cell = results.cell(name, "--cell")
    request = Request(results, cell, scenario)
    example = forecast(request, read_request(request), Progress())
    scores = pd.read_parquet(shipped / "scores.parquet")
    rows = scores[
        np.logical_and.reduce([scores[key] == value for key, value in asdict(cell).items()])
        & (scores.metric == "forecast_probability")
        & (scores.scenario == scenario)
        & (scores.step == -1)
    ].set_index("dimension")
    simulator, _ = request.real_system()
    outcomes = outcome_probabilities(simulator, example)
    assert len(outcomes) >= 3
    dimensions = ["all", *list(outcomes)[1:]]
    for dimension, (probability, _) in zip(dimensions, outcomes.values(), strict=True):
        assert np.float32(probability) == rows.value[dimension]


@pytest.mark.parametrize("environment", ["pusher", "uav"])
def test_a_test_scenario_is_sampled_again_to_the_bit(
    smoke: tuple[Path, Done], shipped: Path, environment: str
) -> None:
    (path,) = [
        manifest.with_name("test.safetensors")
        for manifest in (smoke[0] / "work" / "collect").glob("*/manifest.json")
        if json.loads(manifest.read_text())["label"] == environment
    ]
    test, results = ScenarioSet.load(path), folder.read(shipped)
    request = Request(results, results.cell(f"{environment}/low/full_vae/seed-0", "--cell"), 6)
    example = forecast(request, read_request(request), Progress())
    for name in ("s0", "actions", "goal", "observed"):
        np.testing.assert_array_equal(getattr(example, name), getattr(test, name)[6])


@pytest.mark.parametrize("suffix", ["csv", "json"])
def test_a_file_and_a_scenario_agree(shipped: Path, tmp_path: Path, suffix: str) -> None:
    plan, common = tmp_path / f"plan.{suffix}", ["--cell", CELL, "--out", shipped]
    written = study("forecast", *common, "--scenario", 4, "--write", plan)
    assert (written.code, written.out) == (0, f"{plan}\n")
    of_scenario, of_file = (
        study("forecast", *common, *what, "--scenario", 4, "--samples", 9, "--save", tmp_path / to)
        for what, to in (([], "scenario.rrd"), (["--file", plan], "file.rrd"))
    )
    assert of_scenario.code == of_file.code == 0, of_file
    numbers = [done.out.split("reaches the target")[1] for done in (of_scenario, of_file)]
    assert numbers[0].replace("scenario.rrd", "file.rrd") == numbers[1]
    assert "9 forecasts and 6 observed rollouts of 12 steps, 4.8 s" in of_file.out
    assert "plan from a file" in of_file.out
    results = folder.read(shipped)
    requests = (Request(results, results.cell(CELL, ""), 4, file, 9) for file in (None, plan))
    one, other = (
        forecast(request, read_request(request), Progress()).forecast for request in requests
    )
    np.testing.assert_array_equal(one, other)


def test_what_is_printed_and_recorded(shipped: Path, tmp_path: Path) -> None:
    path = tmp_path / "new" / "forecast.rrd"
    given = ["--cell", CELL, "--scenario", 2, "--samples", 20, "--out", shipped, "--save", path]
    done = study("forecast", *given)
    assert done.code == 0
    assert done.err == ""
    lines = done.out.splitlines()
    for name in ("reaches the target", "ends at the target", "stays above 15 m"):
        (line,) = [line for line in lines if line.startswith(name)]
        assert all(0 <= float(number) <= 1 for number in line.split()[-3:])
    start = next(index for index, line in enumerate(lines) if line.startswith("step"))
    for line in lines[start + 1 : start + 6]:
        _, _, total, aleatoric, epistemic, _ = map(float, line.split())
        if epistemic > 0:
            assert total**2 == pytest.approx(aleatoric**2 + epistemic**2, rel=0.01)
        else:  # the unbiased estimate is below zero by chance
            assert total <= aleatoric
    check(path)
    assert properties(path)["samples"] == 20
    found = entities(path)
    assert "/scenario_2/success/forecast" in found
    assert "/scenario_2/position_std" in found


def test_without_an_ensemble_the_variance_has_no_parts(shipped: Path, tmp_path: Path) -> None:
    cell = "uav/high/full_vae/seed-0"
    given = ["--cell", cell, "--scenario", 0, "--out", shipped, "--save", tmp_path / "a.rrd"]
    done = study("forecast", *given)
    assert done.code == 0
    assert [line.split()[3:5] for line in done.out.splitlines() if line.startswith("12 ")] == [
        ["–", "–"]
    ]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--scenario", 8], "--scenario: got 8; the test set has 8, 0 to 7"),
        (["--scenario", -1], "--scenario: got -1"),
        ([], "--scenario: its value is missing"),
        (["--scenario", 0, "--samples", 1], "--samples: got 1; it must be at least 2"),
        (["--scenario", 0, "--save", "a.rr"], "--save: got 'a.rr'; it must be a .rrd file"),
        (["--scenario", 0, "--write", "a.txt"], ".csv or a .json file"),
        (["--scenario", 0, "--sample", 3], "did you mean '--samples'?"),
        (["--scenario", "one"], "--scenario: got 'one'; it must be a whole number"),
        (["--file", "none.csv"], "there is no file 'none.csv'"),
        (["--file", "plan.txt"], "a plan is a .csv or a .json file"),
        (["--scenario", 0, "--cell", "uav/high/residual_va/seed-0"], f"did you mean '{CELL}'?"),
        (["--scenario", 0, "--out", "results/no_such"], "there is no study in 'results/no_such'"),
    ],
    ids=str,
)
def test_bad_input_gets_one_line(shipped: Path, arguments: list[object], expected: str) -> None:
    done = study("forecast", "--cell", CELL, "--out", shipped, *arguments)
    assert done.code == 2
    assert expected in done.err
    assert done.err.count("\n") == 1


@pytest.mark.parametrize("harm", ["flip", "remove"])
def test_damaged_weights(shipped: Path, tmp_path: Path, harm: str) -> None:
    out = Path(shutil.copytree(shipped, tmp_path / "out"))
    path = out / "weights" / f"{CELL}.safetensors"
    if harm == "flip":
        content = bytearray(path.read_bytes())
        content[-1] ^= 1
        path.write_bytes(content)
    else:
        path.unlink()
    recording = tmp_path / "forecast.rrd"
    command = ["forecast", "--cell", CELL, "--scenario", 0, "--out", out, "--save", recording]
    done = study(*command)
    assert done.code == 1
    assert done.err.startswith(f"error: {path} is {'damaged' if harm == 'flip' else 'missing'}")
    assert done.err.count("\n") == 1
