"""Verdicts on claims, from the scores of a study.

Each contrast of a claim has an effect with a 95 % interval (`study.metrics.intervals`). Terms of
one environment are paired on scenarios and seeds. By the rule of the claim a contrast holds, is
contradicted or is undecided; a contrast whose interval contains 0 is never contradicted.
`Outcome` defines the verdict on a claim.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import pandas as pd

from study.claims.checks import CHECKS
from study.claims.claim import EQUIVALENCE_MARGIN, Claim, Contrast, Quantity, Rule
from study.claims.paper import PAPER_CLAIMS
from study.common.arrays import Doubles
from study.metrics.intervals import sum_of_means
from study.metrics.tables.table import LEVELLESS, select

CLAIMS = (*PAPER_CLAIMS, *CHECKS)

LARGEST_RATIO = 1000.0
"""Ratios of variances are clipped to this one and its inverse, so that no dimension dominates."""

VARIANCE_METRICS = frozenset({"log_aleatoric_error", "log_aleatoric_ratio"})
"""Metrics with one value for each dimension of the state, and not for each scenario."""

UNTRAINED = -1
"""The seed that stands for a model without training. Its seeds only repeat the sampling, so its
scores are averaged over them and are not paired with those of trained models."""


class Status(StrEnum):
    """The result of one contrast; see `study.claims.claim.Rule`."""

    HOLDS = "holds"
    UNDECIDED = "undecided"
    CONTRADICTED = "contradicted"


class Outcome(StrEnum):
    """The verdict on a claim."""

    REPRODUCED = "reproduced"
    """All its contrasts hold."""
    PARTLY = "partly"
    """Some of its contrasts hold, and some do not."""
    NOT_REPRODUCED = "not reproduced"
    """None of its contrasts holds, and at least one is contradicted."""
    INCONCLUSIVE = "inconclusive"
    """All its contrasts are undecided."""
    NOT_RUN = "not run"
    """Scores that it needs are missing."""


@dataclass(frozen=True)
class Finding:
    """The effect of one contrast.

    Attributes:
        text: description of the contrast.
        effect: the weighted sum of its mean scores.
        low: lower end of the 95 % interval.
        high: upper end.
        scenarios: number of scenarios; for a claim about variances, of dimensions.
        seeds: number of training seeds.
        status: the result.
        margin: the smallest effect of interest, or the margin of an equivalence test.
    """

    text: str
    effect: float
    low: float
    high: float
    scenarios: int
    seeds: int
    status: Status
    margin: float


@dataclass(frozen=True)
class Verdict:
    """The verdict on a claim.

    Attributes:
        claim: the claim.
        outcome: the verdict.
        findings: one for each contrast; none if scores are missing.
        missing: names of the cells without scores.
    """

    claim: Claim
    outcome: Outcome
    findings: tuple[Finding, ...]
    missing: tuple[str, ...]

    @property
    def smallest(self) -> Finding | None:
        """The finding with the smallest effect; None without any."""
        return min(self.findings, key=lambda finding: finding.effect, default=None)


def judge(scores: pd.DataFrame, claims: Iterable[Claim] = CLAIMS) -> list[Verdict]:
    """The verdict on each claim.

    Args:
        scores: the tidy table of a study (`study.metrics.tables.table`), with the columns of cells.
            Other environments and models are ignored.
        claims: the paper's and our checks by default.
    """
    table = _Quantities(scores)
    return [_judge(claim, table) for claim in claims]


class _Quantities:
    """Values [seeds, scenarios] or [seeds, dimensions] of each quantity, cached."""

    def __init__(self, scores: pd.DataFrame) -> None:
        per_scenario = (scores["step"] == -1) & (scores["scenario"] >= 0)
        ratio = (scores["metric"] == "aleatoric_ratio") & (scores["dimension"] != "all")
        self._scores = scores[per_scenario | ratio]
        self._tables: dict[Quantity, pd.DataFrame] = {}

    def __getitem__(self, quantity: Quantity) -> pd.DataFrame:
        if quantity not in self._tables:
            self._tables[quantity] = self._select(quantity)
        return self._tables[quantity]

    def _select(self, quantity: Quantity) -> pd.DataFrame:
        cell = (quantity.environment, quantity.level, quantity.model)
        if quantity.metric in VARIANCE_METRICS:
            ratio = select(self._scores, "aleatoric_ratio", *cell, by="dimension and step")
            largest = np.log(LARGEST_RATIO)
            with np.errstate(divide="ignore"):
                logarithm = ratio.transform(np.log).clip(-largest, largest)
            if quantity.metric == "log_aleatoric_error":
                logarithm = logarithm.abs()
            # The mean over the steps at which the true variance is not negligible.
            table = logarithm.T.groupby(level="dimension").mean().T.dropna(axis="columns")
        else:
            table = select(self._scores, quantity.metric, *cell)
        if quantity.model in LEVELLESS and len(table):
            return table.mean().to_frame(UNTRAINED).T
        return table


def _judge(claim: Claim, table: _Quantities) -> Verdict:
    needed = dict.fromkeys(quantity for c in claim.contrasts for _, quantity in c.terms)
    missing = tuple(f"{q.environment}/{q.level}/{q.model}" for q in needed if table[q].size == 0)
    if missing:
        return Verdict(claim, Outcome.NOT_RUN, (), missing)
    findings = tuple(_measure(claim, contrast, table) for contrast in claim.contrasts)
    return Verdict(claim, _outcome(finding.status for finding in findings), findings, ())


def _outcome(statuses: Iterable[Status]) -> Outcome:
    distinct = set(statuses)
    if distinct == {Status.HOLDS}:
        return Outcome.REPRODUCED
    if Status.HOLDS in distinct:
        return Outcome.PARTLY
    return Outcome.NOT_REPRODUCED if Status.CONTRADICTED in distinct else Outcome.INCONCLUSIVE


def _measure(claim: Claim, contrast: Contrast, table: _Quantities) -> Finding:
    environments = dict.fromkeys(quantity.environment for _, quantity in contrast.terms)
    parts = [
        _paired([(w, table[q]) for w, q in contrast.terms if q.environment == environment])
        for environment in environments
    ]
    # Seeds and scenarios of two environments are independent.
    found = sum_of_means(parts)
    effect, low, high = (float(value) for value in (found.estimate, found.low, found.high))
    margin = claim.smallest_effect
    if claim.rule is Rule.EQUAL:
        typical = np.mean([table[quantity].to_numpy().mean() for _, quantity in contrast.terms])
        margin = max(margin, EQUIVALENCE_MARGIN * float(typical))
    return Finding(
        text=contrast.text,
        effect=effect,
        low=low,
        high=high,
        scenarios=min(part.shape[1] for part in parts),
        seeds=min(part.shape[0] for part in parts),
        status=_status(claim.rule, effect, low, high, margin),
        margin=margin,
    )


def _paired(terms: Sequence[tuple[float, pd.DataFrame]]) -> Doubles:
    """The weighted sum of tables [seeds, S] over the seeds and scenarios that all tables have.

    Without a common seed, it is the sum of averages over seeds: [1, S].
    """
    trained = [set(frame.index) for _, frame in terms if UNTRAINED not in frame.index]
    seeds = sorted(set.intersection(*trained)) if trained else []
    scenarios = sorted(set.intersection(*(set(frame.columns) for _, frame in terms)))
    total = np.zeros((max(len(seeds), 1), len(scenarios)))
    for weight, frame in terms:
        paired = seeds and UNTRAINED not in frame.index
        values = frame.loc[seeds] if paired else frame.mean().to_frame().T
        with np.errstate(invalid="ignore"):
            total += weight * values[scenarios].to_numpy(np.float64)
    return total


def _status(rule: Rule, effect: float, low: float, high: float, margin: float) -> Status:
    contradicted = high < 0 and effect <= -margin
    if rule is Rule.ABOVE:
        holds = low > 0 and effect >= margin
    elif rule is Rule.EQUAL:
        holds = -margin < low and high < margin
        contradicted = low > margin or high < -margin
    else:
        holds = low > -margin
    if holds:
        return Status.HOLDS
    return Status.CONTRADICTED if contradicted else Status.UNDECIDED
