"""What each value of a choice changes: the page ``choices.md``, and the strongest choice."""

from collections.abc import Iterator

import numpy as np
import pandas as pd

from study.claims.claim import Claim
from study.claims.judge import CLAIMS
from study.config.names import label, markdown
from study.multiverse.design import RANDOM
from study.multiverse.effects import curve, judged, support
from study.multiverse.folder import Multiverse
from study.multiverse.influence import Change, Influence, Term, influence
from study.multiverse.one_way import OneWay, one_way

DASH = "–"
CONTRASTS = 3
"""A claim with up to as many contrasts has a table for each of them."""
INTRODUCTION = """\
Each value of a choice is compared with the first value of the choice.

- *Change of the effect*: its mean, by a linear regression on all choices over all universes,
  without interactions, with a 95 % t interval (HC3). In bold: the interval excludes zero.
- *Rank*: the same for the rank of the effect among the universes, in percent of their number. A
  universe in which a model diverges has a large effect, but a rank like any other.
- *Share*: of the variance of the ranks, what the regression loses without the choice, corrected
  for chance (ε²). In bold: it is significant (F test at the level 0.05, with a Bonferroni
  correction for the choices of a table, and none for the number of claims).
- *Alone*: what the choice explains without the others (ε²). Choices that differ together between
  the base readings occur together in most universes. They explain much alone, and add little to
  each other: then the regression cannot tell which of them decides.
- *Random: rank* and *random: alone*: only over the universes with random values. There, values
  are assigned independently, except for the excluded combinations, though some choices are
  correlated by chance. The difference of mean ranks, in percent of the number of these universes,
  and the share without the other choices. In bold: it is significant.
- *At* a base reading: the change of the effect when that reading is changed in this choice alone.
  If two base readings differ, the choice interacts with others.

The first table of a claim is about its decisive contrast, the one with the smallest effect in a
universe. It may be another contrast in another universe, so a claim of two or three contrasts has a
table for each of them too. For a claim that two scores are comparable, the effect is the margin
minus the absolute difference. An effect that is not finite is left out.""".splitlines()


def claims_of(multiverse: Multiverse) -> list[Claim]:
    """The claims with an effect in at least one universe."""
    names = judged(multiverse.effects)
    return [claim for claim in CLAIMS if claim.id in names]


def influence_on(
    multiverse: Multiverse, claim: str, contrast: str | None = None
) -> Influence | None:
    """The regression of the support for a claim on the choices, see `curve` for the arguments."""
    effects = _support(multiverse, claim, contrast)
    return influence(effects, multiverse.values, multiverse.design.choices)


def each_alone(
    multiverse: Multiverse, claim: str, contrast: str | None = None, group: str | None = None
) -> dict[str, OneWay]:
    """What each choice explains of the support for a claim without the others.

    Args:
        multiverse: the results.
        claim: the identity of the claim.
        contrast: see `curve`.
        group: only the universes of this group, see `Universe.group`.
    """
    effects = _support(multiverse, claim, contrast)
    chosen = [u.name for u in multiverse.universes if group in (None, u.group)]
    effects = effects[effects.index.isin(chosen)]
    return one_way(effects, multiverse.values, multiverse.design.choices)


def _support(multiverse: Multiverse, claim: str, contrast: str | None) -> "pd.Series[float]":
    rule = next(known.rule for known in CLAIMS if known.id == claim)
    return support(curve(multiverse.effects, claim, contrast), rule)


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
        *INTRODUCTION,
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
    heads += ["random: rank", "random: alone", *(f"at {label(base)}" for base in bases)]
    yield f"| {' | '.join(heads)} |"
    yield f"|---|---|{'---:|' * (len(heads) - 2)}"
    alone, random = (each_alone(multiverse, claim.id, contrast, group) for group in (None, RANDOM))
    order = sorted(regression.shares, key=regression.shares.__getitem__, reverse=True)
    for name in order:
        terms = [term for term in regression.terms if term.choice == name]
        for term in terms:
            at_bases = [_at_base(multiverse, regression.effects, base, term) for base in bases]
            head = [label(name), markdown(term.value), str(term.universes)]
            changes = [_change(term.effect, "{:+.4f}"), _change(term.rank, "{:+.0%}")]
            share = _share(regression.shares[name], regression.is_significant(name))
            shares = [share, f"{alone[name].share:.0%}"] if term is terms[0] else ["", ""]
            randoms = list(_random(random.get(name), term, term is terms[0]))
            yield f"| {' | '.join([*head, *changes, *shares, *randoms, *at_bases])} |"


def _random(found: OneWay | None, term: Term, is_first: bool) -> tuple[str, str]:
    """The rank of a value and the share of its choice, over the universes with random values."""
    if found is None:
        return DASH, DASH if is_first else ""
    rank = found.ranks.get(term.value)
    share = _share(found.share, found.is_significant) if is_first else ""
    return DASH if rank is None else f"{rank:+.0%}", share


def _share(share: float, is_significant: bool) -> str:
    return f"**{share:.0%}**" if is_significant else f"{share:.0%}"


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
