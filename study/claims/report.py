"""The report of verdicts on claims, as Markdown and as JSON."""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from study.claims.claim import EQUIVALENCE_MARGIN, OURS, Claim, Rule
from study.claims.judge import LARGEST_RATIO, VARIANCE_METRICS, Finding, Outcome, Verdict
from study.metrics.intervals import basis, training_seeds

RULES = {
    Rule.ABOVE: (
        "its interval is above zero, and its effect is at least the smallest effect of interest",
        "its interval is below zero, and its effect is below zero by at least the smallest effect "
        "of interest",
    ),
    Rule.EQUAL: (
        "its interval is between minus the margin and the margin",
        "its interval is above the margin, or below minus the margin",
    ),
    Rule.NOT_BELOW: (
        "its interval is above minus the smallest effect of interest",
        "its interval is below zero, and its effect is below zero by at least the smallest effect "
        "of interest",
    ),
}
"""When a contrast holds, and when it is contradicted, by rule."""

OUTCOMES = {
    Outcome.REPRODUCED: "all its contrasts hold",
    Outcome.PARTLY: "some of its contrasts hold; the others are undecided or contradicted",
    Outcome.NOT_REPRODUCED: "none of its contrasts holds, and at least one is contradicted",
    Outcome.INCONCLUSIVE: "all its contrasts are undecided",
    Outcome.NOT_RUN: "scores that it needs are missing",
}

TITLE = "# Verdicts on the claims of the paper"
TERMS = {
    "claim": "a statement of the results section of the paper (IV) that scores can decide",
    "check": "a statement of this study that is judged like a claim",
    "contrast": "a difference of mean scores, or another weighted sum of them; a claim has one or "
    "more",
    "effect": "the value of a contrast; the table above shows the contrast of a claim with the "
    "smallest one",
    "interval": "95 % t interval of the effect over training seeds and scenarios, valid for few "
    "seeds (Banerjee 1960; `study.metrics.intervals`); paired: models are compared on the same "
    "seeds and scenarios. With one seed it is over scenarios alone, and does not include the "
    "variation of training",
    "above, below, between": "of an interval: both of its ends are",
    "Scenarios, Seeds": "sample sizes n: test scenarios (an initial state, a goal and actions), "
    "or dimensions of the state for a claim about variances; and training seeds that all models of "
    "the contrast have",
    "smallest effect of interest": "the smallest effect that matters, by metric; fixed before any "
    "run",
    "margin": f"of comparable values: {100 * EQUIVALENCE_MARGIN:.0f} % of the mean of the compared "
    "scores, and at least the smallest effect of interest",
    "holds, contradicted": "the result of a contrast, by the rule of its claim: see the next table",
    "undecided": "neither; a contrast whose interval contains zero is never contradicted",
    "low, high epistemic": "the level of epistemic uncertainty: all training data, or a part",
    "simulator itself, oracle": "the simulator as a forecaster: its expected scores are the lowest "
    "possible",
    "MMD²": "maximum mean discrepancy of forecast and observed states, unbiased, averaged over "
    "steps and dimensions of the state; no unit",
    "Brier score": "the plain score: mean (p - o)² of the forecast probability p of the goal and "
    "its outcome o; no unit",
    "energy score": "of the whole state, in standard deviations of the training data",
    "aleatoric variance": "forecast variance that is not between the members of the ensemble. "
    "Effects are natural logarithms of its ratio to the true variance: the mean over the steps at "
    f"which the true variance is not negligible, of logarithms within ±ln {LARGEST_RATIO:g}",
    "closer, advantage": "of an aleatoric variance: by the absolute value of that logarithm",
}
"""Each word of the report that has a meaning of its own."""


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
    if not verdicts:
        return f"{TITLE}\n\nThe paper says nothing about the environments of this study.\n"
    return "\n".join(
        [
            TITLE,
            "",
            _summary(verdicts),
            "",
            "| Claim | Verdict | Effect [95 % interval] | Scenarios | Seeds |",
            "|---|---|---|---|---|",
            *(_row(verdict) for verdict in verdicts),
            "",
            "## Terms",
            "",
            "| Term | Meaning |",
            "|---|---|",
            *(f"| {term} | {meaning} |" for term, meaning in TERMS.items()),
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
    seeds = {finding.seeds for verdict in verdicts for finding in verdict.findings}
    return f"{line} {training_seeds(seeds)}; {basis(seeds)}." if seeds else line


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
