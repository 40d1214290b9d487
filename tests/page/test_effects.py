"""Verdicts and bars: on one axis, in multiples of the margin."""

import itertools
from typing import Any

import pytest

from study.page.effects import LARGEST, TICKS, WIDTH, position, tally, ticks, views

FINDING = {
    "text": "full VAE minus residual VAE",
    "effect": 0.02,
    "low": 0.01,
    "high": 0.03,
    "margin": 0.01,
    "scenarios": 250,
    "seeds": 1,
    "status": "holds",
}


def claim(**changes: Any) -> dict[str, Any]:
    base = {
        "id": "c",
        "section": "IV-A",
        "text": "a claim",
        "rule": "above zero",
        "verdict": "reproduced",
        "smallest_finding": FINDING,
        "findings": [FINDING],
    }
    return base | changes


def test_the_axis_is_ordered_and_symmetric() -> None:
    places = [place for place, _ in ticks()]
    assert all(a < b for a, b in itertools.pairwise(places))
    assert [WIDTH - place for place in reversed(places)] == pytest.approx(places, abs=0.011)
    assert (position(0), position(LARGEST), position(-LARGEST)) == (WIDTH / 2, WIDTH, 0)
    assert len(places) == len(TICKS)


def test_an_effect_is_shown_in_margins() -> None:
    ((view,), _) = views([claim()])
    bar = view.effects[0].bar
    assert bar is not None
    assert (bar.low, bar.effect, bar.high) == (position(1), position(2), position(3))
    assert bar.region == (position(1), WIDTH)
    assert bar.label == "effect +0.0200 [+0.0100, +0.0300]; in margins +2.0"
    assert "n = 250 × 1 seed\n" in view.effects[0].trace


@pytest.mark.parametrize(
    ("rule", "region"),
    [
        ("above zero", (position(1), WIDTH)),
        ("not below zero", (position(-1), WIDTH)),
        ("within a margin of zero", (position(-1), position(1))),
    ],
)
def test_the_shaded_area_is_where_the_rule_holds(rule: str, region: tuple[float, float]) -> None:
    ((view,), _) = views([claim(rule=rule)])
    assert view.effects[0].bar is not None
    assert view.effects[0].bar.region == region


def test_an_infinite_effect_is_cut_at_the_end_of_the_axis() -> None:
    finding = FINDING | {"effect": "inf", "low": "-inf", "high": "inf"}
    ((view,), _) = views([claim(findings=[finding], smallest_finding=finding)])
    bar = view.effects[0].bar
    assert bar is not None
    assert (bar.low, bar.effect, bar.high) == (0, WIDTH, WIDTH)
    assert view.effects[0].shown == "∞ [−∞, ∞]"


def test_a_claim_without_scores_has_no_bar() -> None:
    ((view,), _) = views([claim(verdict="not run", findings=[], smallest_finding=None)])
    assert view.smallest is None
    assert view.effects == []


def test_checks_are_apart_and_every_verdict_is_counted() -> None:
    claims, checks = views(
        [claim(), claim(section="ours"), claim(verdict="partly"), claim(verdict="of a new kind")]
    )
    assert (len(claims), len(checks)) == (3, 1)
    assert [(name, count) for _, name, count, _ in tally(claims)] == [
        ("reproduced", 1),
        ("partly", 1),
        ("of a new kind", 1),
    ]
