"""Judges the claims of `study.claims.paper` on the scores, and reports.

Each contrast of a claim is an average with a 95 % interval, paired on scenarios and on seeds where
both sides come from the same environment, and it holds, is contradicted or stays undecided by the
rule of its claim. Then the claim is

- *reproduced* if all its contrasts hold,
- *partly* reproduced if some hold,
- *not reproduced* if none holds and at least one is contradicted,
- *inconclusive* if all are undecided,
- *not run* if scores that it needs are missing.
"""

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd

from study.claims.paper import CLAIMS, MARGIN, Claim, Contrast, Quantity, Rule
from study.common.arrays import Doubles
from study.metrics.intervals import percentiles, resampled_means
from study.metrics.tables.table import LEVELLESS, select

FARTHEST = np.log(1000.0)
"""An aleatoric variance that is wrong by more than this factor (0 and infinity too) counts as this
wrong, so that one dimension cannot outweigh all others."""


OF_VARIANCE = frozenset({"log_aleatoric_error", "log_aleatoric_ratio"})
"""Metrics whose unit is a dimension of the state, not a scenario."""

EVERY_SEED = -1
"""The seed of what is not trained: its seeds are repetitions, not to be paired with anyone's."""


class Status(StrEnum):
    """What the data say of one contrast."""

    HOLDS = "holds"
    UNDECIDED = "undecided"
    CONTRADICTED = "contradicted"


class Outcome(StrEnum):
    """What they say of a claim."""

    REPRODUCED = "reproduced"
    PARTLY = "partly"
    NOT_REPRODUCED = "not reproduced"
    INCONCLUSIVE = "inconclusive"
    NOT_RUN = "not run"


@dataclass(frozen=True)
class Finding:
    """One contrast, measured. `scenarios` counts dimensions for a claim about variances."""

    words: str
    effect: float
    low: float
    high: float
    scenarios: int
    seeds: int
    status: Status
    margin: float
    """The least effect, or the margin of an equivalence, that was applied."""


@dataclass(frozen=True)
class Verdict:
    """A claim, what became of it and why; `missing` names the cells without scores."""

    claim: Claim
    outcome: Outcome
    findings: tuple[Finding, ...]
    missing: tuple[str, ...]

    @property
    def deciding(self) -> Finding | None:
        """The contrast with the smallest effect: the weakest link of the claim."""
        return min(self.findings, key=lambda finding: finding.effect, default=None)


def judge(scores: pd.DataFrame, claims: Iterable[Claim] = CLAIMS) -> list[Verdict]:
    """A verdict on each claim.

    Args:
        scores: columns environment, level, model, seed and those of `study.metrics.scores`. Cells
            of other environments or models are ignored; missing ones give "not run".
        claims: the paper's, if not given.
    """
    table = _Quantities(scores)
    return [_judge(claim, table) for claim in claims]


class _Quantities:
    """Values [seeds, scenarios], or [seeds, dimensions], by quantity, each read once."""

    def __init__(self, scores: pd.DataFrame) -> None:
        per_scenario = (scores["step"] == -1) & (scores["scenario"] >= 0)
        ratio = (scores["metric"] == "aleatoric_ratio") & (scores["dimension"] != "all")
        self._scores = scores[per_scenario | ratio]
        self._read: dict[Quantity, pd.DataFrame] = {}

    def __getitem__(self, quantity: Quantity) -> pd.DataFrame:
        if quantity not in self._read:
            self._read[quantity] = self._select(quantity)
        return self._read[quantity]

    def _select(self, quantity: Quantity) -> pd.DataFrame:
        cell = (quantity.environment, quantity.level, quantity.model)
        if quantity.metric in OF_VARIANCE:
            ratio = select(self._scores, "aleatoric_ratio", *cell, by="dimension and step")
            with np.errstate(divide="ignore"):
                logarithm = ratio.transform(np.log).clip(-FARTHEST, FARTHEST)
            if quantity.metric == "log_aleatoric_error":
                logarithm = logarithm.abs()
            # Mean over the steps at which the true variance is not negligible.
            table = logarithm.T.groupby(level="dimension").mean().T.dropna(axis="columns")
        else:
            table = select(self._scores, quantity.metric, *cell)
        if quantity.model in LEVELLESS and len(table):
            return table.mean().to_frame(EVERY_SEED).T
        return table


def _judge(claim: Claim, table: _Quantities) -> Verdict:
    needed = dict.fromkeys(quantity for c in claim.contrasts for _, quantity in c.terms)
    missing = tuple(f"{q.environment}/{q.level}/{q.model}" for q in needed if table[q].size == 0)
    if missing:
        return Verdict(claim, Outcome.NOT_RUN, (), missing)
    findings = tuple(_measure(claim, contrast, table) for contrast in claim.contrasts)
    return Verdict(claim, _outcome(finding.status for finding in findings), findings, ())


def _outcome(statuses: Iterable[Status]) -> Outcome:
    seen = set(statuses)
    if seen == {Status.HOLDS}:
        return Outcome.REPRODUCED
    if Status.HOLDS in seen:
        return Outcome.PARTLY
    return Outcome.NOT_REPRODUCED if Status.CONTRADICTED in seen else Outcome.INCONCLUSIVE


def _measure(claim: Claim, contrast: Contrast, table: _Quantities) -> Finding:
    environments = dict.fromkeys(quantity.environment for _, quantity in contrast.terms)
    parts = [
        _paired([(w, table[q]) for w, q in contrast.terms if q.environment == environment])
        for environment in environments
    ]
    # Scenarios of two environments have nothing to do with each other: resampled on their own.
    draws = sum(resampled_means(part, seed=number) for number, part in enumerate(parts))
    effect = float(sum(part.mean() for part in parts))
    low, high = (float(end) for end in percentiles(np.asarray(draws)))
    margin = claim.least
    if claim.rule is Rule.EQUAL:
        typical = np.mean([table[quantity].to_numpy().mean() for _, quantity in contrast.terms])
        margin = max(margin, MARGIN * float(typical))
    return Finding(
        words=contrast.words,
        effect=effect,
        low=low,
        high=high,
        scenarios=min(part.shape[1] for part in parts),
        seeds=min(part.shape[0] for part in parts),
        status=_status(claim.rule, effect, low, high, margin),
        margin=margin,
    )


def _paired(terms: Sequence[tuple[float, pd.DataFrame]]) -> Doubles:
    """The weighted sum of tables [seeds, S] over the seeds and scenarios that all of them have.

    Where there is no seed in common, averages over seeds stand for all: [1, S].
    """
    trained = [set(frame.index) for _, frame in terms if EVERY_SEED not in frame.index]
    seeds = sorted(set.intersection(*trained)) if trained else []
    scenarios = sorted(set.intersection(*(set(frame.columns) for _, frame in terms)))
    total = np.zeros((max(len(seeds), 1), len(scenarios)))
    for weight, frame in terms:
        paired = seeds and EVERY_SEED not in frame.index
        values = frame.loc[seeds] if paired else frame.mean().to_frame().T
        total += weight * values[scenarios].to_numpy(np.float64)
    return total


def _status(rule: Rule, effect: float, low: float, high: float, margin: float) -> Status:
    if rule is Rule.ABOVE:
        holds = low > 0 and effect >= margin
        contradicted = high < margin
    elif rule is Rule.EQUAL:
        holds = -margin < low and high < margin
        contradicted = low > margin or high < -margin
    else:
        contradicted = high < 0 and effect <= -margin
        holds = not contradicted
    if holds:
        return Status.HOLDS
    return Status.CONTRADICTED if contradicted else Status.UNDECIDED


def to_json(verdicts: Sequence[Verdict]) -> str:
    """Everything about the verdicts, for other programs."""
    entries = [
        {
            "id": verdict.claim.id,
            "section": verdict.claim.section,
            "words": verdict.claim.words,
            "rule": verdict.claim.rule.value,
            "least_effect": verdict.claim.least,
            "verdict": verdict.outcome.value,
            "deciding": _plain(verdict.deciding) if verdict.deciding else None,
            "findings": [_plain(finding) for finding in verdict.findings],
            "missing": list(verdict.missing),
            "figure": verdict.claim.figure,
        }
        for verdict in verdicts
    ]
    return json.dumps(entries, indent=2, ensure_ascii=False) + "\n"


def _plain(finding: Finding) -> dict[str, Any]:
    """JSON has no infinity: an effect that is not finite is a word."""
    return {
        name: str(value) if isinstance(value, float) and not np.isfinite(value) else value
        for name, value in asdict(finding).items()
    }


def to_markdown(verdicts: Sequence[Verdict]) -> str:
    """A report: a summary, a table, and for each claim its evidence with a link to its figure."""
    rows = [_row(verdict) for verdict in verdicts]
    return "\n".join(
        [
            "# The claims of the paper, and what became of them",
            "",
            _summary(verdicts),
            "",
            "| Claim | Verdict | Smallest effect [95 % interval] | Scenarios | Seeds |",
            "|---|---|---|---|---|",
            *rows,
            "",
            "## Evidence",
            "",
            "Effects are differences of averages, with 95 % intervals by a bootstrap over seeds and"
            " scenarios. A contrast *holds* when its interval is above zero and its effect at least"
            " the least that counts; claims of comparable values are tested for equivalence within"
            " the margin given, and the checks only fail where a model is better than the oracle.",
            "",
            *(_evidence(verdict) for verdict in verdicts),
            "",
        ]
    )


def _summary(verdicts: Sequence[Verdict]) -> str:
    paper = [verdict for verdict in verdicts if verdict.claim.section != "ours"]
    ours = [verdict for verdict in verdicts if verdict.claim.section == "ours"]
    line = f"Of {len(paper)} claims of the paper: {_tally(paper)}."
    if ours:
        line += f" Of {len(ours)} of our own: {_tally(ours)}."
    seeds = sorted({finding.seeds for verdict in verdicts for finding in verdict.findings})
    if seeds == [1]:
        return (
            f"{line} There is one training seed: the intervals cover scenarios, and say nothing of"
            " how much training varies."
        )
    ends = " to ".join(map(str, dict.fromkeys([seeds[0], seeds[-1]]))) if seeds else "none"
    return f"{line} Training seeds: {ends}."


def _tally(verdicts: Sequence[Verdict]) -> str:
    counts = Counter(verdict.outcome for verdict in verdicts)
    return ", ".join(f"{counts[outcome]} {outcome}" for outcome in Outcome if counts[outcome])


def _row(verdict: Verdict) -> str:
    finding = verdict.deciding
    if finding is None:
        return f"| {verdict.claim.words} | {verdict.outcome} | – | – | – |"
    return (
        f"| {verdict.claim.words} | {verdict.outcome} | {_interval(finding)} "
        f"| {_count(verdict.claim, finding)} | {finding.seeds} |"
    )


def _count(claim: Claim, finding: Finding) -> str:
    of_variance = claim.contrasts[0].terms[0][1].metric in OF_VARIANCE
    return f"{finding.scenarios} dimensions" if of_variance else str(finding.scenarios)


def _evidence(verdict: Verdict) -> str:
    claim = verdict.claim
    head = f"- **{claim.id}** ({_source(claim)}): *{verdict.outcome}*."
    if verdict.missing:
        return f"{head} No scores of {', '.join(verdict.missing)}."
    bound = "margin ±" if claim.rule is Rule.EQUAL else "least effect "
    margin = verdict.findings[0].margin
    contrasts = "; ".join(f"{f.words} {_interval(f)} {f.status}" for f in verdict.findings)
    return f"{head} {contrasts} ({bound}{margin:.3g}). See [{claim.figure}]({claim.figure})."


def _source(claim: Claim) -> str:
    return "our own" if claim.section == "ours" else f"section {claim.section}"


def _interval(finding: Finding) -> str:
    return f"{finding.effect:+.4f} [{finding.low:+.4f}, {finding.high:+.4f}]"
