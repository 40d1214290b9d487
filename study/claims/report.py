"""The report of verdicts on claims, as Markdown and as JSON."""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from study.claims.claim import EQUIVALENCE_MARGIN, OURS, Claim, Rule
from study.claims.judge import VARIANCE_METRICS, Finding, Outcome, Verdict

RULES = {
    Rule.ABOVE: (
        "its interval is above zero, and its effect is at least the smallest effect of interest",
        "its interval is below the smallest effect of interest",
    ),
    Rule.EQUAL: ("its interval is within the margin", "its interval is outside the margin"),
    Rule.NOT_BELOW: (
        "it is not contradicted",
        "its interval is below zero, and its effect is below zero by at least the smallest effect "
        "of interest",
    ),
}
"""When a contrast holds, and when it is contradicted, by rule."""

OUTCOMES = {
    Outcome.REPRODUCED: "all its contrasts hold",
    Outcome.PARTLY: "some of its contrasts hold, and some do not",
    Outcome.NOT_REPRODUCED: "none of its contrasts holds, and at least one is contradicted",
    Outcome.INCONCLUSIVE: "all its contrasts are undecided",
    Outcome.NOT_RUN: "scores that it needs are missing",
}

TERMS = f"""## Terms

A *contrast* is a difference of mean scores, or another weighted sum of them. Its *effect* is the
value of this sum. Its interval is a 95 % interval by a bootstrap over training seeds and scenarios.
MMD² and Brier scores have no unit. Energy scores are in standard deviations of the training data.
Effects on variances are natural logarithms of ratios.

The table above shows the contrast with the smallest effect of each claim. The columns *Scenarios*
and *Seeds* are the sample sizes n. A claim about variances counts dimensions of the state in place
of scenarios. The *smallest effect of interest* of each metric was fixed before any run.

The rule of a claim decides each of its contrasts. A contrast that neither holds nor is contradicted
is *undecided*. The *margin* of comparable values is
{100 * EQUIVALENCE_MARGIN:.0f} % of their mean, and at least the smallest effect of interest."""


def to_json(verdicts: Sequence[Verdict]) -> str:
    """All verdicts and findings, for other programs."""
    entries = [
        {
            "id": verdict.claim.id,
            "section": verdict.claim.section,
            "text": verdict.claim.text,
            "rule": verdict.claim.rule.value,
            "smallest_effect_of_interest": verdict.claim.smallest_effect,
            "verdict": verdict.outcome.value,
            "smallest_finding": _plain(verdict.smallest) if verdict.smallest else None,
            "findings": [_plain(finding) for finding in verdict.findings],
            "missing": list(verdict.missing),
            "figure": verdict.claim.figure,
        }
        for verdict in verdicts
    ]
    return json.dumps(entries, indent=2, ensure_ascii=False) + "\n"


def _plain(finding: Finding) -> dict[str, Any]:
    """The finding for JSON, which has no infinity: an effect that is not finite becomes text."""
    return {
        name: str(value) if isinstance(value, float) and not np.isfinite(value) else value
        for name, value in asdict(finding).items()
    }


def to_markdown(verdicts: Sequence[Verdict]) -> str:
    """A summary, a table of claims, the terms, and the findings with links to figures."""
    return "\n".join(
        [
            "# Verdicts on the claims of the paper",
            "",
            _summary(verdicts),
            "",
            "| Claim | Verdict | Effect [95 % interval] | Scenarios | Seeds |",
            "|---|---|---|---|---|",
            *(_row(verdict) for verdict in verdicts),
            "",
            TERMS,
            "",
            "| Rule | A contrast *holds* if | A contrast is *contradicted* if |",
            "|---|---|---|",
            *(f"| {rule.value} | {holds} | {contra} |" for rule, (holds, contra) in RULES.items()),
            "",
            "| Verdict | Meaning |",
            "|---|---|",
            *(f"| {outcome} | {meaning} |" for outcome, meaning in OUTCOMES.items()),
            "",
            "## Contrasts of each claim",
            "",
            *(_contrasts(verdict) for verdict in verdicts),
            "",
        ]
    )


def _summary(verdicts: Sequence[Verdict]) -> str:
    claims = [verdict for verdict in verdicts if verdict.claim.section != OURS]
    checks = [verdict for verdict in verdicts if verdict.claim.section == OURS]
    line = f"Of {len(claims)} claims of the paper: {_tally(claims)}."
    if checks:
        line += f" Of {len(checks)} checks of this study: {_tally(checks)}."
    seeds = sorted({finding.seeds for verdict in verdicts for finding in verdict.findings})
    if seeds == [1]:
        return (
            f"{line} There is one training seed: the intervals are over scenarios only, and do not"
            " include the variation of training."
        )
    ends = " to ".join(map(str, dict.fromkeys([seeds[0], seeds[-1]]))) if seeds else "none"
    return f"{line} Training seeds: {ends}."


def _tally(verdicts: Sequence[Verdict]) -> str:
    counts = Counter(verdict.outcome for verdict in verdicts)
    return ", ".join(f"{counts[outcome]} {outcome}" for outcome in Outcome if counts[outcome])


def _row(verdict: Verdict) -> str:
    finding = verdict.smallest
    if finding is None:
        return f"| {verdict.claim.text} | {verdict.outcome} | – | – | – |"
    return (
        f"| {verdict.claim.text} | {verdict.outcome} | {_interval(finding)} "
        f"| {_count(verdict.claim, finding)} | {finding.seeds} |"
    )


def _count(claim: Claim, finding: Finding) -> str:
    of_variance = claim.contrasts[0].terms[0][1].metric in VARIANCE_METRICS
    return f"{finding.scenarios} dimensions" if of_variance else str(finding.scenarios)


def _contrasts(verdict: Verdict) -> str:
    claim = verdict.claim
    head = f"- **{claim.id}** ({_source(claim)}, {claim.rule.value}): *{verdict.outcome}*."
    if verdict.missing:
        return f"{head} No scores of {', '.join(verdict.missing)}."
    margin = verdict.findings[0].margin
    kind = "margin ±" if claim.rule is Rule.EQUAL else "smallest effect of interest "
    contrasts = "; ".join(f"{f.text} {_interval(f)} {f.status}" for f in verdict.findings)
    return f"{head} {contrasts} ({kind}{margin:.3g}). See [{claim.figure}]({claim.figure})."


def _source(claim: Claim) -> str:
    return "check" if claim.section == OURS else f"section {claim.section}"


def _interval(finding: Finding) -> str:
    return f"{finding.effect:+.4f} [{finding.low:+.4f}, {finding.high:+.4f}]"
