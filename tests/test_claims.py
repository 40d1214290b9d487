"""Verdicts on scores where they are known."""

import json
from collections.abc import Mapping

import numpy as np
import pandas as pd
import pytest

from study.claims import Outcome, Verdict, judge, to_json, to_markdown
from study.paper import CLAIMS, FULL, MLP, ORACLE, RESIDUAL
from tests.synthetic import AS_THE_PAPER, scores

Averages = Mapping[str, tuple[float, float]]


def verdicts(table: pd.DataFrame) -> dict[str, Verdict]:
    return {verdict.claim.id: verdict for verdict in judge(table)}


def with_mmd(**changed: tuple[float, float]) -> dict[str, Verdict]:
    return verdicts(scores(AS_THE_PAPER | changed))


def drop(table: pd.DataFrame, **cell: str) -> pd.DataFrame:
    matches = np.logical_and.reduce([table[name] == value for name, value in cell.items()])
    return table[~matches]


def test_everything_as_the_paper_says() -> None:
    found = verdicts(scores())
    assert len(found) == len(CLAIMS)
    assert {verdict.outcome for verdict in found.values()} == {Outcome.REPRODUCED}


def test_the_opposite() -> None:
    found = with_mmd(**{RESIDUAL: (0.4, 0.5), FULL: (0.2, 0.1), MLP: (0.05, 0.06)})
    for claim in ("mmd-residual-lowest-uav-low", "mmd-mlp-highest-uav-low", "mmd-full-rises-uav"):
        assert found[claim].outcome is Outcome.NOT_REPRODUCED
    assert found["brier-order-pusher-low"].outcome is Outcome.NOT_REPRODUCED


def test_half_of_it() -> None:
    """The residual VAE beats the MLP, and not the full VAE."""
    found = with_mmd(**{RESIDUAL: (0.15, 0.2)})
    assert found["mmd-residual-lowest-pusher-low"].outcome is Outcome.PARTLY
    statuses = [finding.status for finding in found["mmd-residual-lowest-pusher-low"].findings]
    assert statuses == ["contradicted", "holds"]


def test_a_tie_is_no_advantage() -> None:
    found = with_mmd(**{RESIDUAL: (0.1, 0.16), MLP: (0.1, 0.16)})
    assert found["mmd-residual-lowest-pusher-low"].outcome is Outcome.NOT_REPRODUCED


def test_an_exact_tie_is_no_advantage_either() -> None:
    table = scores()
    tied = table[table.model == FULL].assign(model=RESIDUAL)
    found = verdicts(pd.concat([table[table.model != RESIDUAL], tied], ignore_index=True))
    first = found["mmd-residual-lowest-pusher-low"].findings[0]
    assert (first.effect, first.low, first.high) == (0, 0, 0)
    assert first.status == "contradicted"


def test_a_difference_too_small_to_matter() -> None:
    """Sure, and below the least effect: not what the paper claims."""
    found = verdicts(scores(AS_THE_PAPER | {FULL: (0.051, 0.052)}, spread=0.0001))
    first = found["mmd-residual-lowest-pusher-low"].findings[0]
    assert first.low > 0
    assert first.status == "contradicted"


def test_noise_is_inconclusive() -> None:
    found = verdicts(scores(AS_THE_PAPER | {FULL: (0.1, 0.11)}, spread=2.0))
    assert found["mmd-full-rises-pusher"].outcome is Outcome.INCONCLUSIVE
    # A failure to reject is not equivalence.
    assert found[f"mmd-steady-pusher-{RESIDUAL}"].outcome is Outcome.INCONCLUSIVE


def test_comparable_needs_a_margin() -> None:
    found = with_mmd(**{RESIDUAL: (0.05, 0.09)})
    assert found[f"mmd-steady-pusher-{RESIDUAL}"].outcome is Outcome.NOT_REPRODUCED
    assert found[f"mmd-steady-pusher-{MLP}"].outcome is Outcome.REPRODUCED


def test_a_model_better_than_the_oracle_fails_the_check() -> None:
    found = with_mmd(**{ORACLE: (0.08, 0.08)})
    assert found["check-mmd2-oracle-pusher"].outcome is Outcome.PARTLY
    beaten = [f.words for f in found["check-mmd2-oracle-pusher"].findings if f.effect < 0]
    assert beaten == ["residual VAE, low epistemic, minus oracle"] + [
        "residual VAE, high epistemic, minus oracle"
    ]


def test_brier_scores_that_fall_on_the_uav() -> None:
    falling = {RESIDUAL: (0.2, 0.1), FULL: (0.3, 0.2), MLP: (0.5, 0.4)}
    found = verdicts(scores(brier=falling))
    assert found["brier-rises-uav"].outcome is Outcome.NOT_REPRODUCED
    assert found["brier-order-uav-high"].outcome is Outcome.REPRODUCED


def test_one_seed() -> None:
    table = scores(seeds=1)
    found = judge(table)
    assert {finding.seeds for verdict in found for finding in verdict.findings} == {1}
    assert "There is one training seed" in to_markdown(found)
    assert "There is one training seed" not in to_markdown(judge(scores(seeds=2)))


def test_missing_cells_are_not_run() -> None:
    found = verdicts(drop(scores(), environment="uav", model=FULL, level="high"))
    assert found["mmd-full-rises-uav"].outcome is Outcome.NOT_RUN
    assert found["mmd-full-rises-uav"].missing == ("uav/high/full_vae",)
    assert found["mmd-full-rises-pusher"].outcome is Outcome.REPRODUCED
    assert "No scores of uav/high/full_vae." in to_markdown(list(found.values()))


def test_no_scores_at_all() -> None:
    table = scores().iloc[:0]
    found = judge(table)
    assert {verdict.outcome for verdict in found} == {Outcome.NOT_RUN}
    assert "not run" in to_markdown(found)
    json.loads(to_json(found))


def test_other_environments_and_models_change_nothing() -> None:
    table = scores()
    other = table.assign(environment="toy")
    more = table[table.model == FULL].assign(model="flow")
    assert judge(pd.concat([table, other, more], ignore_index=True)) == judge(table)
    assert {verdict.outcome for verdict in judge(other)} == {Outcome.NOT_RUN}


def test_a_seed_that_failed_is_left_out_of_both_sides() -> None:
    table = scores()
    lacking = table[~((table.model == FULL) & (table.seed == 1))]
    finding = verdicts(lacking)["mmd-residual-lowest-uav-low"].findings[0]
    assert finding.seeds == 2
    assert finding.effect == pytest.approx(0.075)


def test_the_oracle_needs_one_seed_and_one_level() -> None:
    table = scores()
    oracle = table.model == ORACLE
    once = table[~oracle | ((table.seed == 0) & (table.level == "low"))]
    found = verdicts(once)["check-mmd2-oracle-uav"]
    assert found.outcome is Outcome.REPRODUCED
    assert {finding.seeds for finding in found.findings} == {3}


def test_infinite_variance_does_not_break_anything() -> None:
    table = scores()
    ratio = (table.metric == "variance_ratio") & (table.model == FULL) & (table.dimension == "x")
    table.loc[ratio, "value"] = np.inf
    table.loc[(table.metric == "variance_ratio") & (table.dimension == "y"), "value"] = np.nan
    finding = verdicts(table)["variance-residual-closer-uav"].findings[0]
    assert np.isfinite([finding.effect, finding.low, finding.high]).all()
    assert finding.scenarios == 2


def test_reports() -> None:
    found = judge(scores())
    report = to_markdown(found)
    assert report.count("\n- **") == len(CLAIMS)
    assert "(figures/mmd_pusher.png)" in report
    entries = json.loads(to_json(found))
    assert [entry["id"] for entry in entries] == [claim.id for claim in CLAIMS]
    assert entries[0]["deciding"]["effect"] == pytest.approx(0.05)
    assert len({claim.id for claim in CLAIMS}) == len(CLAIMS)


def test_the_same_scores_give_the_same_report() -> None:
    assert to_json(judge(scores())) == to_json(judge(scores().sample(frac=1, random_state=0)))
