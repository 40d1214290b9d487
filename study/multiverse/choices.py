"""What each value of a choice changes: the page ``choices.md``, and the strongest choice."""

from collections.abc import Iterator

import numpy as np
import pandas as pd

from study.claims.claim import Claim
from study.claims.judge import CLAIMS
from study.config.names import label, markdown
from study.multiverse.effects import curve, judged, support
from study.multiverse.folder import Multiverse
from study.multiverse.influence import Change, Influence, Term, influence

DASH = "–"
CONTRASTS = 3
"""A claim with up to as many contrasts has a table for each of them."""


def claims_of(multiverse: Multiverse) -> list[Claim]:
    """The claims with an effect in at least one universe."""
    names = judged(multiverse.effects)
    return [claim for claim in CLAIMS if claim.id in names]


def influence_on(
    multiverse: Multiverse, claim: str, contrast: str | None = None
) -> Influence | None:
    """The regression of the support for a claim on the choices, see `curve` for the arguments."""
    rule = next(known.rule for known in CLAIMS if known.id == claim)
    found = support(curve(multiverse.effects, claim, contrast), rule)
    return influence(found, multiverse.values, multiverse.design.choices)


def strongest_choice(multiverse: Multiverse, claim: str) -> str | None:
    """The choice that moves the effect of a claim most, with its share of the variance of ranks.

    None if the share may be due to chance, or if too few universes have scores.
    """
    regression = influence_on(multiverse, claim)
    if regression is None or regression.strongest is None:
        return None
    return f"{label(regression.strongest)} ({regression.shares[regression.strongest]:.0%})"


def choices_page(multiverse: Multiverse) -> str:
    """The page ``choices.md``: a table for each claim, and for each of its contrasts."""
    lines = [
        "# Which choice moves the effect of each claim",
        "",
        "For each value of a choice: the mean change of the effect relative to the first "
        "value of the choice, by a linear regression over all universes without interactions, with "
        "a 95 % t interval (HC3). A change in bold has an interval without zero. *Rank*: the same "
        "for the rank of the effect among the universes, in percent of their number. A universe in "
        "which a model diverges has a large effect, but a rank like any other. *Share*: of the "
        "variance of the ranks, what is lost without the choice, corrected for chance (ε²); in "
        "bold if it is significant. *Alone*: what the choice explains without the others (adjusted "
        "R²). Choices that differ together between the base readings occur together in most "
        "universes. They explain much alone, and add little to each other: then the design cannot "
        "tell which of them decides. The columns of the base readings "
        "show the change of the effect when that reading is changed in this choice alone. If they "
        "differ from each other, the choice interacts with others.",
        "",
        "The first table of a claim is about its decisive contrast, the one with the smallest "
        "effect in a universe. It may be another contrast in another universe, so a claim of two "
        "or three contrasts has a table for each of them too. For a claim that two scores are "
        "comparable, the effect is the margin minus the absolute difference. An effect that is not "
        "finite is left out.",
        "",
    ]
    for claim in claims_of(multiverse):
        lines += [f"## {claim.text}", "", f"`{claim.id}`, {claim.rule.value}.", ""]
        lines += [*_influence_table(multiverse, claim), ""]
        contrasts = [contrast.text for contrast in claim.contrasts]
        if 1 < len(contrasts) <= CONTRASTS:
            for contrast in contrasts:
                table = _influence_table(multiverse, claim, contrast)
                lines += [f"### {_sentence(contrast)}", "", *table, ""]
    return "\n".join(lines)


def _influence_table(
    multiverse: Multiverse, claim: Claim, contrast: str | None = None
) -> Iterator[str]:
    regression = influence_on(multiverse, claim.id, contrast)
    if regression is None:
        yield "Too few universes have scores to tell the choices apart."
        return
    bases = list(multiverse.design.bases)
    yield (
        f"{len(regression.effects)} universes. The choices explain {regression.explained:.0%} of "
        "the variance of the ranks (adjusted R²)."
    )
    yield ""
    heads = ["choice", "value", "universes", "change of the effect", "rank", "share", "alone"]
    yield f"| {' | '.join([*heads, *(f'at {label(base)}' for base in bases)])} |"
    yield f"|---|---|---:|---:|---:|---:|---:|{'---:|' * len(bases)}"
    order = sorted(regression.shares, key=regression.shares.__getitem__, reverse=True)
    for name in order:
        terms = [term for term in regression.terms if term.choice == name]
        for term in terms:
            at_bases = [_at_base(multiverse, regression.effects, base, term) for base in bases]
            shares = [_share(regression, name), f"{regression.alone[name]:.0%}"]
            shares = shares if term is terms[0] else ["", ""]
            changes = [_change(term.effect, "{:+.4f}"), _change(term.rank, "{:+.0%}")]
            head = [label(name), markdown(term.value), str(term.universes)]
            yield f"| {' | '.join([*head, *changes, *shares, *at_bases])} |"


def _share(regression: Influence, choice: str) -> str:
    text = f"{regression.shares[choice]:.0%}"
    return f"**{text}**" if regression.is_significant(choice) else text


def _change(change: Change, form: str) -> str:
    mean, low, high = (form.format(value) for value in (change.mean, change.low, change.high))
    if not np.isfinite(change.low):
        return f"{mean} [unknown]"
    text = f"{mean} [{low}, {high}]"
    return f"**{text}**" if change.low > 0 or change.high < 0 else text


def _at_base(multiverse: Multiverse, effects: "pd.Series[float]", base: str, term: Term) -> str:
    """The effect with this value minus that with the first value, all other values as in a base."""
    design = multiverse.design
    choice = next(c for c in design.choices if c.name == term.choice)
    by_key = {design.key(universe.values): universe.name for universe in multiverse.universes}
    names = [
        by_key.get(design.key({**design.bases[base], choice.name: value}))
        for value in (term.value, choice.default)
    ]
    if any(name not in effects.index for name in names):
        return DASH
    changed, reference = (float(effects.loc[str(name)]) for name in names)
    return f"{changed - reference:+.4f}"


def _sentence(text: str) -> str:
    """Text with a capital letter, without changing the other letters."""
    return text[:1].upper() + text[1:]
