"""The answer of a study: verdicts on claims, and a bar for each effect and its interval.

Effects of different metrics have one axis: the effect divided by its margin, which is the smallest
effect of interest or the margin of an equivalence test. The axis is linear near zero and
logarithmic far away (asinh).
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from paper_figs.formatting import number
from study.claims.claim import OURS, Rule
from study.claims.judge import Outcome

LARGEST = 40.0
"""The largest multiple of the margin on the axis; longer bars are cut."""
WIDTH = 100.0
"""Width of a bar in its own units."""
TICKS = (-30, -10, -3, -1, 0, 1, 3, 10, 30)
SYMBOLS = {
    Outcome.REPRODUCED.value: "●",
    Outcome.PARTLY.value: "◐",
    Outcome.NOT_REPRODUCED.value: "✕",
    Outcome.INCONCLUSIVE.value: "○",
    Outcome.NOT_RUN.value: "–",
}


@dataclass(frozen=True)
class Bar:
    """One effect with its interval, in units of the axis from 0 to `WIDTH`.

    Attributes:
        effect: position of the effect.
        low: position of the lower end.
        high: position of the upper end.
        region: the ends of the region in which a contrast holds.
        label: the effect and its interval in words.
    """

    effect: float
    low: float
    high: float
    region: tuple[float, float]
    label: str


@dataclass(frozen=True)
class Effect:
    """One contrast of a claim, as it is shown."""

    text: str
    status: str
    shown: str
    trace: str
    bar: Bar | None


@dataclass(frozen=True)
class ClaimView:
    """One claim, as it is shown."""

    id: str
    text: str
    source: str
    verdict: str
    symbol: str
    rule: str
    margin: str
    smallest: Effect | None
    effects: Sequence[Effect]
    missing: Sequence[str]
    figure: str


def views(claims: Sequence[Mapping[str, Any]]) -> tuple[list[ClaimView], list[ClaimView]]:
    """The claims of the paper, and the checks of the study."""
    shown = [_view(claim) for claim in claims]
    checks = [view for view in shown if view.source == "check"]
    return [view for view in shown if view.source != "check"], checks


def tally(shown: Sequence[ClaimView]) -> list[tuple[str, str, int, float]]:
    """Symbol, verdict, number and share of each verdict that occurs."""
    counts = Counter(view.verdict for view in shown)
    names = [outcome.value for outcome in Outcome]
    others = sorted(set(counts) - set(names))
    return [
        (SYMBOLS.get(name, "?"), name, counts[name], counts[name] / len(shown))
        for name in [*names, *others]
        if counts[name]
    ]


def position(multiple: float) -> float:
    """The position of a multiple of the margin on the axis."""
    if math.isnan(multiple):
        return WIDTH / 2
    clipped = min(max(multiple, -LARGEST), LARGEST)
    return round(WIDTH / 2 * (1 + math.asinh(clipped) / math.asinh(LARGEST)), 2)


def ticks() -> list[tuple[float, str]]:
    """Position and label of each tick."""
    return [(position(tick), f"{tick:+d}".replace("-", "−") if tick else "0") for tick in TICKS]


def _view(claim: Mapping[str, Any]) -> ClaimView:
    findings = [finding for finding in claim["findings"] if isinstance(finding, Mapping)]
    rule = str(claim.get("rule", ""))
    smallest = claim.get("smallest_finding")
    section = str(claim["section"])
    margins = {number(_float(finding.get("margin")), 4) for finding in findings}
    verdict = str(claim["verdict"])
    return ClaimView(
        id=str(claim["id"]),
        text=str(claim["text"]),
        source="check" if section == OURS else f"section {section}",
        verdict=verdict,
        symbol=SYMBOLS.get(verdict, "?"),
        rule=rule,
        margin=", ".join(sorted(margins)),
        smallest=_effect(smallest, rule) if isinstance(smallest, Mapping) else None,
        effects=[_effect(finding, rule) for finding in findings],
        missing=[str(name) for name in claim.get("missing", ())],
        figure=str(claim.get("figure", "")),
    )


def _effect(finding: Mapping[str, Any], rule: str) -> Effect:
    effect, low, high, margin = (
        _float(finding.get(name)) for name in ("effect", "low", "high", "margin")
    )
    shown = f"{_signed(effect)} [{_signed(low)}, {_signed(high)}]"
    seeds, scenarios = finding.get("seeds"), finding.get("scenarios")
    name, status = str(finding.get("text", "")), str(finding.get("status", ""))
    trace = (
        f"{name}: {status}\n{shown}, 95 % interval\nn = {scenarios} × {seeds} seed"
        f"{'' if seeds == 1 else 's'}\nmargin {number(margin, 4)}\nclaims.json"
    )
    bar = None
    if margin > 0 and not math.isnan(effect):
        bar = Bar(
            position(effect / margin),
            position(low / margin),
            position(high / margin),
            _region(rule),
            f"effect {shown}; in margins {effect / margin:+.1f}",
        )
    return Effect(name, status, shown, trace, bar)


def _region(rule: str) -> tuple[float, float]:
    if rule == Rule.EQUAL.value:
        return position(-1), position(1)
    return position(1 if rule == Rule.ABOVE.value else -1), WIDTH


def _float(value: Any) -> float:
    """A number of ``claims.json``, in which an infinity is text."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan


def _signed(value: float) -> str:
    text = number(value, 4)
    return f"+{text}" if value > 0 and text != "∞" else text
