"""Verdicts on scores for which they are known."""

import json
from itertools import combinations

import numpy as np
import pandas as pd
import pytest

from study.claims.claim import Rule
from study.claims.judge import CLAIMS, Outcome, Verdict, _status, judge
from study.claims.report import to_json, to_markdown
from study.config.names import FULL, LEVELS, MLP, ORACLE, RESIDUAL
from tests.helpers.synthetic import AS_THE_PAPER, scores


def verdicts(table: pd.DataFrame, *ids: str) -> list[Verdict]:
    """Verdicts on the claims with these names, in their order."""
    by_id = {claim.id: claim for claim in CLAIMS}
    return judge(table, [by_id[name] for name in ids])


def outcome(table: pd.DataFrame, name: str) -> Outcome:
    return verdicts(table, name)[0].outcome


def with_mmd(changed: dict[str, tuple[float, float]], deviation: float = 0.02) -> pd.DataFrame:
    return scores(AS_THE_PAPER | changed, deviation=deviation)


def drop(table: pd.DataFrame, **cell: str) -> pd.DataFrame:
    matches = np.logical_and.reduce([table[name] == value for name, value in cell.items()])
    return table[~matches]


def test_scores_as_in_the_paper_reproduce_every_claim() -> None:
    found = judge(scores())
    assert [verdict.claim for verdict in found] == list(CLAIMS)
    assert {verdict.outcome for verdict in found} == {Outcome.REPRODUCED}


def test_the_opposite_of_the_paper() -> None:
    table = with_mmd({RESIDUAL: (0.4, 0.5), FULL: (0.2, 0.1), MLP: (0.05, 0.06)})
    found = verdicts(
        table,
        "mmd-residual-lowest-uav-low",
        "mmd-mlp-highest-uav-low",
        "mmd-full-rises-uav",
        "brier-order-pusher-low",
    )
    assert {verdict.outcome for verdict in found} == {Outcome.NOT_REPRODUCED}


def test_a_claim_that_holds_in_part() -> None:
    """The residual VAE beats the MLP, and the full VAE beats the residual VAE."""
    table = with_mmd({RESIDUAL: (0.15, 0.2)})
    (found,) = verdicts(table, "mmd-residual-lowest-pusher-low")
    assert found.outcome is Outcome.PARTLY
    assert [finding.status for finding in found.findings] == ["contradicted", "holds"]


def test_a_tie_is_no_advantage_and_no_disadvantage() -> None:
    table = with_mmd({RESIDUAL: (0.1, 0.16), MLP: (0.1, 0.16)})
    assert outcome(table, "mmd-residual-lowest-pusher-low") is Outcome.INCONCLUSIVE


def test_an_exact_tie_is_undecided_too() -> None:
    table = scores()
    tied = table[table.model == FULL].assign(model=RESIDUAL)
    table = pd.concat([table[table.model != RESIDUAL], tied], ignore_index=True)
    first = verdicts(table, "mmd-residual-lowest-pusher-low")[0].findings[0]
    assert (first.effect, first.low, first.high) == (0, 0, 0)
    assert first.status == "undecided"


def test_a_difference_too_small_to_matter() -> None:
    """The interval is on one side of zero, but the effect is below the smallest of interest."""
    for mmd2 in (0.051, 0.049):
        table = with_mmd({FULL: (mmd2, 0.052)}, deviation=0.0001)
        first = verdicts(table, "mmd-residual-lowest-pusher-low")[0].findings[0]
        assert first.low * first.high > 0
        assert first.status == "undecided"


INTERVALS = np.array([-9, -3, -1.5, -1, -0.5, 0, 0.5, 1, 1.5, 3, 9])
"""Ends of intervals; the smallest effect of interest is 1."""


@pytest.mark.parametrize("rule", Rule)
def test_an_interval_that_contains_zero_contradicts_nothing(rule: Rule) -> None:
    for low, high in combinations(INTERVALS, 2):
        for effect in (low, (low + high) / 2, high):
            status = _status(rule, effect, low, high, margin=1.0)
            if low <= 0 <= high:
                assert status != "contradicted"
            if status == "contradicted":
                assert abs(effect) >= 1


@pytest.mark.parametrize(
    ("rule", "ends", "status"),
    [
        (Rule.ABOVE, (1, 3), "holds"),
        (Rule.ABOVE, (-0.5, 3), "undecided"),
        (Rule.ABOVE, (-3, 0.5), "undecided"),
        (Rule.ABOVE, (-0.5, 0.5), "undecided"),
        (Rule.ABOVE, (-3, -0.5), "contradicted"),
        (Rule.EQUAL, (-0.5, 0.5), "holds"),
        (Rule.EQUAL, (-0.5, 1.5), "undecided"),
        (Rule.EQUAL, (-9, 9), "undecided"),
        (Rule.EQUAL, (1.5, 3), "contradicted"),
        (Rule.NOT_BELOW, (-0.5, 9), "holds"),
        (Rule.NOT_BELOW, (-1.5, 9), "undecided"),
        (Rule.NOT_BELOW, (-3, -0.5), "contradicted"),
        (Rule.NOT_BELOW, (np.inf, np.inf), "holds"),
        (Rule.NOT_BELOW, (-np.inf, np.inf), "undecided"),
    ],
)
def test_the_rules(rule: Rule, ends: tuple[float, float], status: str) -> None:
    effect = ends[0] if np.isinf(ends[1]) else float(np.mean(ends))
    assert _status(rule, effect, *ends, margin=1.0) == status


def test_two_seeds_that_differ_decide_nothing() -> None:
    """The sign of an advantage that two seeds disagree on is open, however many scenarios."""
    table = scores(seeds=2)
    first = (table.metric == "mmd2") & (table.model == FULL) & (table.seed == 0)
    table.loc[first, "value"] += 0.2
    (found,) = verdicts(table, "mmd-residual-lowest-uav-low")
    assert [finding.status for finding in found.findings] == ["undecided", "holds"]


def test_noise_is_inconclusive() -> None:
    table = with_mmd({FULL: (0.1, 0.11)}, deviation=2.0)
    assert outcome(table, "mmd-full-rises-pusher") is Outcome.INCONCLUSIVE
    # No evidence of a difference is not evidence of equivalence.
    assert outcome(table, f"mmd-steady-pusher-{RESIDUAL}") is Outcome.INCONCLUSIVE


def test_comparable_values_are_within_the_margin() -> None:
    table = with_mmd({RESIDUAL: (0.05, 0.09)})
    assert outcome(table, f"mmd-steady-pusher-{RESIDUAL}") is Outcome.NOT_REPRODUCED
    assert outcome(table, f"mmd-steady-pusher-{MLP}") is Outcome.REPRODUCED


def test_a_model_better_than_the_oracle_fails_the_check() -> None:
    table = with_mmd({ORACLE: (0.08, 0.08)})
    (found,) = verdicts(table, "check-mmd2-oracle-pusher")
    assert found.outcome is Outcome.PARTLY
    beaten = [finding.text for finding in found.findings if finding.status == "contradicted"]
    assert beaten == [f"residual VAE, {level} epistemic, minus oracle" for level in LEVELS]


def test_brier_scores_that_fall_on_the_uav() -> None:
    table = scores(brier={RESIDUAL: (0.2, 0.1), FULL: (0.3, 0.2), MLP: (0.5, 0.4)})
    assert outcome(table, "brier-rises-uav") is Outcome.NOT_REPRODUCED
    assert outcome(table, "brier-order-uav-high") is Outcome.REPRODUCED


def test_one_seed() -> None:
    found = judge(scores(seeds=1))
    assert {finding.seeds for verdict in found for finding in verdict.findings} == {1}
    assert "1 training seed; 95 % t intervals over scenarios only" in to_markdown(found)
    two = verdicts(scores(seeds=2), "mmd-full-rises-uav")
    assert "2 training seeds; 95 % t intervals over training seeds and" in to_markdown(two)


def test_missing_cells_are_not_run() -> None:
    table = drop(scores(), environment="uav", model=FULL, level="high")
    found = verdicts(table, "mmd-full-rises-uav", "mmd-full-rises-pusher")
    assert [verdict.outcome for verdict in found] == [Outcome.NOT_RUN, Outcome.REPRODUCED]
    assert found[0].missing == ("uav/high/full_vae",)
    assert "No scores of uav/high/full_vae." in to_markdown(found)


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
    crowded = pd.concat([table, other, more], ignore_index=True)
    names = ("mmd-uav-larger", "brier-order-uav-low", "check-brier-oracle-pusher")
    assert verdicts(crowded, *names) == verdicts(table, *names)
    assert {verdict.outcome for verdict in judge(other)} == {Outcome.NOT_RUN}


def test_a_seed_that_failed_is_left_out_of_both_sides() -> None:
    table = scores()
    lacking = table[~((table.model == FULL) & (table.seed == 1))]
    finding = verdicts(lacking, "mmd-residual-lowest-uav-low")[0].findings[0]
    assert finding.seeds == 2
    assert finding.effect == pytest.approx(0.075)


def test_the_oracle_needs_one_seed_and_one_level() -> None:
    table = scores()
    oracle = table.model == ORACLE
    once = table[~oracle | ((table.seed == 0) & (table.level == "low"))]
    (found,) = verdicts(once, "check-mmd2-oracle-uav")
    assert found.outcome is Outcome.REPRODUCED
    assert {finding.seeds for finding in found.findings} == {3}


def test_infinite_variances_give_finite_effects() -> None:
    table = scores()
    ratio = (table.metric == "aleatoric_ratio") & (table.model == FULL) & (table.dimension == "x")
    table.loc[ratio, "value"] = np.inf
    table.loc[(table.metric == "aleatoric_ratio") & (table.dimension == "y"), "value"] = np.nan
    finding = verdicts(table, "aleatoric-residual-closer-uav")[0].findings[0]
    assert np.isfinite([finding.effect, finding.low, finding.high]).all()
    assert finding.scenarios == 2


def test_the_order_of_rows_does_not_matter() -> None:
    table = scores()
    names = ("mmd-residual-lowest-uav-low", "mmd-uav-larger", "aleatoric-residual-closer-uav")
    shuffled = table.sample(frac=1, random_state=0)
    assert to_json(verdicts(shuffled, *names)) == to_json(verdicts(table, *names))
