"""``forecast.rrd`` holds the numbers that the examples have."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from study.recording import bands
from study.recording.examples import Example
from study.recording.forecast import record_forecast, success_so_far
from tests.helpers import reading, recordings


@pytest.fixture(scope="module")
def forecast(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("forecast") / "forecast.rrd"
    record_forecast(
        path, recordings.Puck(), recordings.examples(recordings.Puck(), 2), recordings.PROPERTIES
    )
    return path


def test_quantiles_are_recorded(forecast: Path) -> None:
    example = recordings.examples(recordings.Puck(), 2)[0]
    frame = reading.scalars(forecast, "/median/state/x")
    assert frame.index.name == "horizon"
    assert list(frame.index) == list(range(1, 31))
    for source in ("observed", "forecast"):
        for share in bands.QUANTILES:
            expected = np.quantile(getattr(example, source)[..., 0].astype(float), share, axis=0)
            np.testing.assert_allclose(frame[f"{source} {share:.0%}"], expected, rtol=1e-12)


def test_bands_of_a_long_horizon_are_thinned_to_its_end(tmp_path: Path) -> None:
    example = recordings.examples(recordings.Puck(horizon=120), 1)[0]
    record_forecast(tmp_path / "f.rrd", recordings.Puck(horizon=120), [example], {})
    frame = reading.scalars(tmp_path / "f.rrd", "/median/state/x")
    assert list(frame.index) == list(range(3, 121, 3))
    expected = np.median(example.observed[..., 0].astype(float), axis=0)
    np.testing.assert_allclose(frame["observed 50%"], expected[2::3], rtol=1e-12)


def test_probability_of_success_ends_at_the_outcome(forecast: Path) -> None:
    simulator = recordings.Puck()
    for root, example in zip(("median", "best"), recordings.examples(simulator, 2), strict=True):
        for source in ("observed", "forecast"):
            share = reading.scalars(forecast, f"/{root}/success/{source}")["value"]
            assert (share.diff().dropna() >= 0).all()
            outcome = simulator.outcome(getattr(example, source), example.goal)
            assert share.iloc[-1] == pytest.approx(outcome.mean())


def test_states_that_are_not_finite_never_reach_the_target() -> None:
    simulator = recordings.Puck()
    states = recordings.examples(simulator, 1)[0].observed.copy()
    states[:, 10:] = np.nan
    states[0, 5] = np.inf
    share = success_so_far(simulator, states, np.array([0.8, 0.8], dtype=np.float32))
    assert share[-1] == share[9]


def test_a_diverged_forecast_is_recorded(tmp_path: Path) -> None:
    example = recordings.examples(recordings.Puck(), 1)[0]
    example.forecast[:, 5:] = 1e30
    example.forecast[3:, 20:] = np.nan
    record_forecast(tmp_path / "f.rrd", recordings.Puck(), [example], {})
    assert reading.scalars(tmp_path / "f.rrd", "/median/state/x").shape == (30, 10)


def test_standard_deviations_are_the_roots_of_the_variances(forecast: Path) -> None:
    example = recordings.examples(recordings.Puck(), 2)[0]
    frame = reading.scalars(forecast, "/median/position_std")
    position = recordings.Puck().position(example.observed).astype(float)
    variance = position.var(axis=0, ddof=1).sum(axis=-1)
    np.testing.assert_allclose(frame["observed"] ** 2, variance, rtol=1e-6)
    assert example.aleatoric is not None
    assert example.epistemic is not None
    np.testing.assert_allclose(frame["forecast: aleatoric"] ** 2, example.aleatoric, atol=1e-12)
    # An estimate below zero is shown as zero.
    assert example.epistemic.min() < 0
    epistemic = np.maximum(example.epistemic, 0)
    np.testing.assert_allclose(frame["forecast: epistemic"] ** 2, epistemic, atol=1e-12)


def test_without_an_ensemble_there_is_no_split(tmp_path: Path) -> None:
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
    assert not {"/median/position_std", "/median/paths/members"} & set(found)


def test_equal_titles_are_numbered(tmp_path: Path) -> None:
    example = recordings.examples(recordings.Puck(), 1)[0]
    record_forecast(tmp_path / "f.rrd", recordings.Puck(), [example] * 3, {})
    roots = {entity.split("/")[1] for entity in reading.entities(tmp_path / "f.rrd")}
    assert {"median", "median_2", "median_3"} <= roots


def test_a_title_with_special_characters_has_all_its_views_below_one_entity(
    tmp_path: Path,
) -> None:
    example = replace(recordings.examples(recordings.Puck(), 1)[0], title="90 % of [MMD²]")
    record_forecast(tmp_path / "f.rrd", recordings.Puck(), [example], {})
    found = reading.entities(tmp_path / "f.rrd")
    (root,) = {name.removesuffix("/about") for name in found if name.endswith("/about")}
    assert f"{root}/scene/puck/cylinders" in found
    assert f"{root}/state/x" in found
    # The scene and the README do not belong to an example.
    assert {name for name in found if not name.startswith(root)} == {
        "/readme",
        *(name for name in found if name.startswith("/scene/")),
    }


def test_a_forecast_recording_is_small(tmp_path: Path) -> None:
    simulator = recordings.Puck(horizon=120)
    examples = [_three_times_as_wide(e) for e in recordings.examples(simulator, 8, 100)]
    # As many dimensions, steps and scenarios as the largest recording of the study has.
    simulator.state = tuple(  # type: ignore[misc]
        type(v)(f"{v.name}{copy}", v.unit, v.meaning)
        for copy in range(3)
        for v in recordings.Puck.state
    )
    record_forecast(tmp_path / "f.rrd", simulator, examples, recordings.PROPERTIES)
    assert (tmp_path / "f.rrd").stat().st_size < 3_000_000


def _three_times_as_wide(example: Example) -> Example:
    """The example with each dimension of the state three times."""
    assert example.members is not None
    return replace(
        example,
        s0=np.concatenate([example.s0] * 3, axis=-1),
        observed=np.concatenate([example.observed] * 3, axis=-1),
        forecast=np.concatenate([example.forecast] * 3, axis=-1),
        members=np.concatenate([example.members] * 3, axis=-1),
    )


def test_properties_are_read_back(forecast: Path) -> None:
    assert reading.properties(forecast) == recordings.PROPERTIES
    assert "/readme" in reading.entities(forecast)
