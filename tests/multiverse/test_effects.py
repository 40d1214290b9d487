"""The table of effects: the numbers of the verdicts, and the specification curve."""

import numpy as np
import pandas as pd
import pytest

from study.claims.judge import CLAIMS, Outcome, judge
from study.multiverse.effects import COLUMNS, curve, effects_of, join, judged, shares
from tests.helpers.multiverse import multiverse
from tests.helpers.synthetic import scores

FIRST = CLAIMS[0].id


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    """The effects of all claims in one universe, without the scores of the UAV."""
    synthetic = scores(seeds=2)
    return effects_of("one", synthetic[synthetic["environment"] == "pusher"])


def test_the_numbers_are_those_of_the_verdicts(table: pd.DataFrame) -> None:
    synthetic = scores(seeds=2)
    verdicts = judge(synthetic[synthetic["environment"] == "pusher"])
    assert list(table["claim"].drop_duplicates()) == [verdict.claim.id for verdict in verdicts]
    for verdict in verdicts:
        rows = table[table["claim"] == verdict.claim.id]
        assert set(rows["verdict"]) == {verdict.outcome.value}
        if not verdict.findings:
            continue
        assert list(rows["effect"]) == [finding.effect for finding in verdict.findings]
        assert list(rows["low"]) == [finding.low for finding in verdict.findings]
        assert list(rows["status"]) == [finding.status.value for finding in verdict.findings]
        decisive = rows[rows["decisive"]]
        assert len(decisive) == 1
        assert decisive["effect"].item() == rows["effect"].min()


def test_a_claim_without_scores_is_not_run(table: pd.DataFrame) -> None:
    rows = table[table["claim"].str.contains("uav")]
    assert set(rows["verdict"]) == {Outcome.NOT_RUN.value}
    assert rows["effect"].isna().all()
    assert not any("uav" in claim for claim in judged(table))
    assert curve(table, "mmd-residual-lowest-uav-low").empty


def test_the_curve_ascends_and_has_every_universe_once() -> None:
    results = multiverse()
    rows = curve(results.effects, FIRST)
    assert rows["effect"].is_monotonic_increasing
    assert sorted(rows["universe"]) == sorted(results.scored)
    assert rows["effect"].max() < 0.5  # the other contrast has effects above


def test_the_curve_of_one_contrast() -> None:
    results = multiverse()
    decisive, other = curve(results.effects, FIRST), curve(results.effects, FIRST, "B")
    assert set(other["contrast"]) == {"B"}
    np.testing.assert_allclose(other["effect"], decisive["effect"] + 1)


def test_shares_are_of_the_universes_with_scores() -> None:
    results = multiverse()
    missing = results.effects["universe"].isin(results.scored[:2])
    effects = results.effects.assign(effect=results.effects["effect"].mask(missing))
    found = shares(effects, FIRST)
    assert sum(found.values()) == pytest.approx(1.0)
    verdicts = curve(effects, FIRST)["verdict"]
    assert len(verdicts) == len(results.scored) - 2
    for verdict, share in found.items():
        assert share == pytest.approx(np.mean([v == verdict.value for v in verdicts]))


def test_no_universe_gives_an_empty_table_with_all_columns() -> None:
    empty = join([])
    assert list(empty.columns) == list(COLUMNS)
    assert judged(empty) == []
