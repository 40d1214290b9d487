"""The effect of every claim in every universe, as a table, and what to read from the table.

The table has a row for each contrast of each claim in each universe, with the columns `COLUMNS`.
The *decisive* contrast of a claim is the one with the smallest effect, as in ``claims.md``.
"""

from collections.abc import Iterable

import numpy as np
import pandas as pd

from study.claims.claim import Rule
from study.claims.judge import CLAIMS, Outcome, Verdict, judge

COLUMNS = {
    "universe": "str",
    "claim": "str",
    "verdict": "str",
    "contrast": "str",
    "decisive": "bool",
    "effect": "float64",
    "low": "float64",
    "high": "float64",
    "status": "str",
    "margin": "float64",
    "scenarios": "int64",
    "seeds": "int64",
}
"""The columns and their types. `verdict` is that on the claim, `status` that on the contrast. A
claim without scores has one row with the verdict `not run` and no effect (NaN)."""

VERDICTS = tuple(outcome for outcome in Outcome if outcome is not Outcome.NOT_RUN)
"""The verdicts of claims that have scores, in the order of tables and figures."""


def effects_of(universe: str, scores: pd.DataFrame) -> pd.DataFrame:
    """The effects of all claims in one universe.

    Args:
        universe: its name.
        scores: the tidy table of its cells, see `study.claims.judge.judge`.
    """
    rows = [row for verdict in judge(scores, CLAIMS) for row in _rows(universe, verdict)]
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype(COLUMNS)


def _rows(universe: str, verdict: Verdict) -> list[tuple[object, ...]]:
    head = (universe, verdict.claim.id, verdict.outcome.value)
    if not verdict.findings:
        return [(*head, "", True, np.nan, np.nan, np.nan, "", np.nan, 0, 0)]
    return [
        (
            *head,
            finding.text,
            finding is verdict.smallest,
            finding.effect,
            finding.low,
            finding.high,
            finding.status.value,
            finding.margin,
            finding.scenarios,
            finding.seeds,
        )
        for finding in verdict.findings
    ]


def join(parts: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """One table of the tables of several universes."""
    empty = pd.DataFrame({name: pd.Series(dtype=kind) for name, kind in COLUMNS.items()})
    return pd.concat([empty, *parts], ignore_index=True).astype(COLUMNS)


def curve(effects: pd.DataFrame, claim: str, contrast: str | None = None) -> pd.DataFrame:
    """The specification curve of a claim: its effects, in ascending order.

    Args:
        effects: the table of all claims.
        claim: id of the claim.
        contrast: one of the claim's contrasts; None for the decisive contrast of each universe.

    Returns:
        one row a universe, without universes that have no scores for the claim. An effect that is
        undefined (NaN) is left out.
    """
    chosen = effects[(effects["claim"] == claim) & effects["effect"].notna()]
    chosen = chosen[chosen["decisive"] if contrast is None else chosen["contrast"] == contrast]
    return chosen.sort_values(["effect", "universe"], kind="stable").reset_index(drop=True)


def support(rows: pd.DataFrame, rule: Rule) -> "pd.Series[float]":
    """How far each universe supports a claim, by the name of the universe; more is better.

    It is the effect. For a claim that two scores are comparable, it is the margin minus the
    absolute effect.

    Args:
        rows: see `curve`.
        rule: of the claim.
    """
    by_universe = rows.set_index("universe")
    if rule is Rule.EQUAL:
        return by_universe["margin"] - by_universe["effect"].abs()
    return by_universe["effect"]


def judged(effects: pd.DataFrame) -> list[str]:
    """The ids of the claims with an effect in at least one universe, in the order of the claims."""
    present = set(effects.loc[effects["effect"].notna(), "claim"])
    return [claim.id for claim in CLAIMS if claim.id in present]


def shares(effects: pd.DataFrame, claim: str) -> dict[Outcome, float]:
    """The share of universes with each verdict on a claim, of those with scores for the claim."""
    verdicts = curve(effects, claim)["verdict"]
    return {verdict: float((verdicts == verdict.value).mean()) for verdict in VERDICTS}
