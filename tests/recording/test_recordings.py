"""What is written into recordings is what is read back from them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun.blueprint as rrb

from study.common.errors import StudyError
from study.recording import bands, fans, reading, scenes
from study.recording.forecasts import record_forecast, success_so_far
from study.recording.integrity import check, replacing
from study.recording.scores import record_scores, reliability
from study.recording.tuning import record_tuning
from tests.helpers import recordings


@pytest.fixture(scope="module")
def forecast(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("forecast") / "forecast.rrd"
    record_forecast(
        path, recordings.Puck(), recordings.examples(recordings.Puck(), 2), recordings.PROPERTIES
    )
    return path


def test_forecast_holds_the_quantiles(forecast: Path) -> None:
    example = recordings.examples(recordings.Puck(), 2)[0]
    frame = reading.scalars(forecast, "/median/state/x")
    assert frame.index.name == "horizon"
    assert list(frame.index) == list(range(1, 31))
    for source in ("observed", "forecast"):
        for level in bands.LEVELS:
            expected = np.quantile(getattr(example, source)[..., 0].astype(float), level, axis=0)
            np.testing.assert_allclose(frame[f"{source} {level:.0%}"], expected, rtol=1e-12)


def test_probability_of_success_ends_at_the_outcome(forecast: Path) -> None:
    simulator = recordings.Puck()
    for root, example in zip(("median", "best"), recordings.examples(simulator, 2), strict=True):
        for source in ("observed", "forecast"):
            share = reading.scalars(forecast, f"/{root}/success/{source}")["value"]
            assert (share.diff().dropna() >= 0).all()
            outcome = simulator.outcome(getattr(example, source), example.goal)
            assert share.iloc[-1] == pytest.approx(outcome.mean())


def test_what_is_not_finite_is_never_close_and_has_no_quantile() -> None:
    simulator = recordings.Puck()
    states = recordings.examples(simulator, 1)[0].observed.copy()
    states[:, 10:] = np.nan
    states[0, 5] = np.inf
    assert np.isnan(bands.quantiles(states)[:, 10:]).all()
    assert np.isfinite(bands.quantiles(states)[:, :10]).all()
    share = success_so_far(simulator, states, np.array([0.8, 0.8], dtype=np.float32))
    assert share[-1] == share[9]


def test_a_diverged_forecast_is_recorded(tmp_path: Path) -> None:
    example = recordings.examples(recordings.Puck(), 1)[0]
    example.forecast[:, 5:] = 1e30
    example.forecast[3:, 20:] = np.nan
    record_forecast(tmp_path / "f.rrd", recordings.Puck(), [example], {})
    assert reading.scalars(tmp_path / "f.rrd", "/median/state/x").shape == (30, 10)


def test_the_spread_is_in_standard_deviations(forecast: Path) -> None:
    example = recordings.examples(recordings.Puck(), 2)[0]
    frame = reading.scalars(forecast, "/median/spread")
    seen = (
        recordings.Puck().position(example.observed).astype(float).var(axis=0, ddof=1).sum(axis=-1)
    )
    np.testing.assert_allclose(frame["observed"] ** 2, seen, rtol=1e-6)
    assert example.aleatoric is not None
    assert example.epistemic is not None
    np.testing.assert_allclose(frame["forecast: aleatoric"] ** 2, example.aleatoric, atol=1e-12)
    # An estimate below zero is drawn as none.
    assert example.epistemic.min() < 0
    known = np.maximum(example.epistemic, 0)
    np.testing.assert_allclose(frame["forecast: epistemic"] ** 2, known, atol=1e-12)


def test_without_an_ensemble_nothing_is_split(tmp_path: Path) -> None:
    example = replace(
        recordings.examples(recordings.Puck(), 1)[0],
        member=None,
        members=None,
        aleatoric=None,
        epistemic=None,
    )
    record_forecast(tmp_path / "f.rrd", recordings.Puck(), [example], {})
    found = reading.entities(tmp_path / "f.rrd")
    assert "/median/paths/forecast" in found
    assert not {"/median/spread", "/median/paths/members"} & set(found)


def test_the_eye_sees_a_flight_from_the_side_and_a_table_from_above() -> None:
    along = np.linspace([0.0, 0.0, 20.0], [100.0, 0.0, 30.0], 50, dtype=np.float32)[None]
    beside = _position(fans.eye(along, along[0, -1]))
    assert abs(beside[0] - 50) < 1  # across the way, from the south
    assert beside[1] < -50
    flat = along * np.array([1, 1, 0], dtype=np.float32)
    above = _position(fans.eye(flat, flat[0, -1]))
    assert above[2] > 2 * abs(above[1])


def _position(eye: rrb.EyeControls3D) -> np.ndarray:
    assert eye.position is not None
    return np.asarray(eye.position.as_arrow_array().to_pylist()[0])


def test_a_forecast_recording_is_small(tmp_path: Path) -> None:
    simulator = recordings.Puck(horizon=120)
    examples = recordings.examples(simulator, 8, 100)
    # Three times the state, as long and as many scenarios as the largest real recording has.
    simulator.state = tuple(  # type: ignore[misc]
        type(v)(f"{v.name}{turn}", v.unit, v.meaning)
        for turn in range(3)
        for v in recordings.Puck.state
    )
    wide = []
    for example in examples:
        example = type(example)(
            **{
                **vars(example),
                **{
                    name: np.concatenate([getattr(example, name)] * 3, axis=-1)
                    for name in ("s0", "observed", "forecast", "members")
                },
            }
        )
        wide.append(example)
    record_forecast(tmp_path / "f.rrd", simulator, wide, recordings.PROPERTIES)
    assert (tmp_path / "f.rrd").stat().st_size < 3_000_000


def test_scores_are_the_same_numbers(tmp_path: Path) -> None:
    table, path = recordings.scores(), tmp_path / "scores.rrd"
    record_scores(path, table, recordings.PROPERTIES)
    stepwise = table[(table["step"] > 0) & (table["scenario"] < 0)]
    for (metric, dimension), rows in stepwise.groupby(["metric", "dimension"]):
        frame = reading.scalars(path, f"/{metric}/{dimension}")
        assert list(frame.index) == list(rows["step"])
        assert list(frame["value"]) == list(rows["value"])
    rows = table[table["metric"] == "forecast_probability"]
    frame = reading.scalars(path, "/by_scenario/forecast_probability")
    assert list(frame["value"]) == list(rows["value"])
    assert reading.scalars(path, "/overall/brier/all")["value"].tolist() == [0.171]
    rows = table[
        (table["metric"] == "mmd2") & (table["step"] == -1) & (table["dimension"] != "all")
    ]
    by_dimension = reading.scalars(path, "/overall/mmd2/dimensions")
    assert by_dimension.iloc[0].to_dict() == dict(
        zip(rows["dimension"], rows["value"], strict=True)
    )


def test_bands_of_a_long_horizon_are_thinned_to_its_end(tmp_path: Path) -> None:
    example = recordings.examples(recordings.Puck(horizon=120), 1)[0]
    record_forecast(tmp_path / "f.rrd", recordings.Puck(horizon=120), [example], {})
    frame = reading.scalars(tmp_path / "f.rrd", "/median/state/x")
    assert list(frame.index) == list(range(3, 121, 3))
    expected = np.median(example.observed[..., 0].astype(float), axis=0)
    np.testing.assert_allclose(frame["observed 50%"], expected[2::3], rtol=1e-12)


def test_an_axis_is_fixed_only_where_the_viewer_would_choose_another() -> None:
    observed = np.linspace(0.0, 1.0, 5)[:, None] * np.ones(9)
    assert bands.axis_range(observed, observed + 0.5) is None
    diverged = bands.axis_range(observed, observed * 100)
    assert diverged == pytest.approx((-0.1, 2.1))
    flat = bands.axis_range(np.full((5, 9), 3.0), np.full((5, 9), 3.0 + 1e-9))
    assert flat is not None
    assert flat[0] < 3.0 < flat[1]


def test_reliability_of_a_calibrated_forecast_is_the_diagonal() -> None:
    forecast = np.linspace(0, 1, 101)
    promised, came_true = reliability(forecast, forecast)
    np.testing.assert_allclose(promised, came_true)
    assert len(promised) == 10


def test_tuning_holds_every_trial(tmp_path: Path) -> None:
    trials, path = recordings.trials(), tmp_path / "tuning.rrd"
    record_tuning(path, trials, recordings.PROPERTIES)
    assert reading.scalars(path, "/beta")["value"].tolist() == [t["beta"] for t in trials]
    complete = {t["number"]: t["value"] for t in trials if t["state"] == "complete"}
    assert reading.scalars(path, "/value/complete")["value"].to_dict() == complete
    best = reading.scalars(path, "/best")["value"]
    assert best.iloc[-1] == min(complete.values())
    curve = reading.scalars(path, "/intermediate/trial_0")["value"].to_dict()
    assert curve == trials[0]["intermediate"]


def test_properties_come_back(forecast: Path) -> None:
    assert reading.properties(forecast) == recordings.PROPERTIES
    assert "/readme" in reading.entities(forecast)


def test_properties_of_one_name_may_differ_in_type(tmp_path: Path) -> None:
    values: list[str | int | float] = ["12", 12, 0.5, "a"]
    for number, value in enumerate(values):
        record_tuning(tmp_path / f"{number}.rrd", recordings.trials(), {"seed": value})
        assert reading.properties(tmp_path / f"{number}.rrd") == {"seed": value}


def test_an_unknown_entity_is_named(forecast: Path) -> None:
    with pytest.raises(StudyError, match="did you mean '/median/state/x'"):
        reading.scalars(forecast, "/median/stat/x")


def test_poses_and_the_capsule_are_where_mujoco_has_them() -> None:
    model = recordings.Puck().scene()
    qpos = np.array([[0.3, -0.2, 0.0], [0.0, 0.0, np.pi / 2]])
    positions, rotations = scenes.body_poses(model, qpos)
    puck = model.body("puck").id
    np.testing.assert_allclose(positions[0, puck], [0.3, -0.2, 0.05], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(rotations, axis=-1), 1, atol=1e-6)
    np.testing.assert_allclose(rotations[0, puck], [0, 0, 0, 1], atol=1e-6)  # xyzw
    rod = model.geom("rod").id
    half = model.geom_size[rod, 1]
    start = scenes.capsule_start(model.geom_pos[rod], model.geom_quat[rod], half)
    ends = sorted([0.0, 0.3], key=lambda y: abs(y - start[1]))
    np.testing.assert_allclose(start, [0, ends[0], 0], atol=1e-6)
    with pytest.raises(ValueError, match="3 numbers, not 9"):
        scenes.body_poses(model, np.zeros((1, 9)))


@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty", "missing", "checksum"])
def test_damage_is_found(forecast: Path, tmp_path: Path, damage: str) -> None:
    path = tmp_path / "forecast.rrd"
    content = bytearray(forecast.read_bytes())
    if damage == "truncated":
        content = content[:-1]
    elif damage == "flipped":
        content[len(content) // 2] ^= 1
    elif damage == "empty":
        content = bytearray()
    if damage != "missing":
        path.write_bytes(content)
    if damage != "checksum":
        sidecar = forecast.with_name("forecast.rrd.sha256").read_text()
        path.with_name("forecast.rrd.sha256").write_text(sidecar)
    with pytest.raises(StudyError) as error:
        check(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)
    check(forecast)


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.rrd"
    with replacing(path) as temporary:
        temporary.write_bytes(b"old")

    def fail() -> None:
        with replacing(path) as temporary:
            temporary.write_bytes(b"half of the n")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert path.read_bytes() == b"old"
    check(path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.rrd", "a.rrd.sha256"]
