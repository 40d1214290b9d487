"""``multiverse.rrd`` holds the effects of the table, and a page for each universe."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from study.claims.judge import CLAIMS
from study.multiverse.effects import VERDICTS, curve
from study.recording.integrity import check
from study.recording.multiverse import order_of_universes, page, record_multiverse, span_of
from tests.helpers import reading
from tests.helpers.multiverse import multiverse

CLAIM = CLAIMS[1].id
RESULTS = multiverse(random=12)
ORDER = order_of_universes(RESULTS, [claim.id for claim in CLAIMS[:4]])


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("multiverse") / "multiverse.rrd"
    record_multiverse(path, RESULTS, {"study": "toy"})
    return path


def test_it_is_complete(path: Path) -> None:
    check(path)


def test_universes_are_in_the_order_of_the_first_claim() -> None:
    assert list(ORDER) == list(curve(RESULTS.effects, CLAIMS[0].id)["universe"])
    assert list(ORDER.values()) == list(range(len(RESULTS.scored)))


def test_effects_and_intervals_are_those_of_the_table(path: Path) -> None:
    rows = curve(RESULTS.effects, CLAIM)
    expected = {ORDER[name]: effect for name, effect in rows[["universe", "effect"]].to_numpy()}
    found = reading.scalars_below(path, f"/effect/{CLAIM}")
    points = {int(str(t)): v for frame in found.values() for t, v in frame["value"].items()}
    assert points == expected
    for verdict in VERDICTS:
        part = rows[rows["verdict"] == verdict.value]
        entity = next((e for e in found if e.replace("\\", "").endswith(f"/{verdict.value}")), None)
        times = list(found[entity].index) if entity else []
        assert times == sorted(ORDER[name] for name in part["universe"])
    interval = reading.scalars(path, f"/interval/{CLAIM}")
    by_position = rows.assign(position=rows["universe"].map(ORDER)).sort_values("position")
    np.testing.assert_array_equal(interval.to_numpy(), by_position[["low", "high"]])


def test_every_universe_has_a_dot_for_its_value_of_each_choice(path: Path) -> None:
    for choice in RESULTS.design.choices:
        frames = reading.scalars_below(path, f"/choice/{choice.name}")
        times = {
            value: set(frames[f"/choice/{choice.name}/{value}"].index) for value in choice.values
        }
        for value in choice.values:
            chosen = {ORDER[n] for n in ORDER if RESULTS.values[n][choice.name] == value}
            assert times[value] == chosen


def test_the_page_of_a_universe() -> None:
    text = page(RESULTS, CLAIMS[:4], "as_written")
    row = curve(RESULTS.effects, CLAIM).set_index("universe").loc["as_written"]
    assert "| forecast | **mean** |" in text
    assert f"| **{row['verdict']}** |" in text
    assert f"{row['effect']:+.4f} [{row['low']:+.4f}, {row['high']:+.4f}]" in text
    assert "pusher/low/residual_vae/seed-0" in text
    assert "--universes 'as_written'" in text


def test_the_panel_of_the_rows(path: Path) -> None:
    text = reading.document(path, "/rows")
    assert "| forecast | mean |" in text
    assert "What does the decoder predict?" in text


def test_the_range_of_a_plot_is_not_that_of_a_model_that_diverges() -> None:
    few = pd.Series([*np.linspace(-0.01, 0.03, 30), 900.0, -50.0, np.inf, np.nan])
    low, high = span_of(few)
    assert -0.05 < low < -0.01
    assert 0.03 < high < 0.06
    low, high = span_of(pd.Series([0.2, 0.3]))
    assert low < 0  # zero is always in it
    low, high = span_of(pd.Series(dtype=float))
    assert low < 0 < high
