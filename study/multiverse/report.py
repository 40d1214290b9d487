"""The pages of a multiverse: a summary of all claims, and what moves the effect of each."""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from study.claims.claim import OURS, Claim
from study.claims.judge import CLAIMS
from study.config.names import ORACLE, label, markdown
from study.metrics.intervals import basis, training_seeds
from study.multiverse.design import Choice, Universe
from study.multiverse.effects import VERDICTS, curve, judged, shares
from study.multiverse.folder import Multiverse
from study.multiverse.influence import Change, Influence, Term, influence

DASH = "–"
CONTRASTS = 3
"""A claim with up to as many contrasts has a table for each of them."""


def pages(multiverse: Multiverse) -> dict[str, str]:
    """The text of each page, by the name of its file."""
    return {"README.md": _summary(multiverse), "choices.md": _choices_page(multiverse)}


def influence_on(
    multiverse: Multiverse, claim: str, contrast: str | None = None
) -> Influence | None:
    """The regression of an effect on the choices, see `curve` for the arguments."""
    rows = curve(multiverse.effects, claim, contrast)
    effects = rows.set_index("universe")["effect"]
    return influence(effects, multiverse.values, multiverse.design.choices)


def strongest_choice(multiverse: Multiverse, claim: str) -> str | None:
    """The choice that moves the effect of a claim most, with its share of the variance.

    None if no choice does, or if too few universes have scores to tell the choices apart.
    """
    regression = influence_on(multiverse, claim)
    if regression is None or regression.strongest is None:
        return None
    return f"{_name(regression.strongest)} ({regression.shares[regression.strongest]:.0%})"


def _claims(multiverse: Multiverse) -> list[Claim]:
    names = judged(multiverse.effects)
    return [claim for claim in CLAIMS if claim.id in names]


def _summary(multiverse: Multiverse) -> str:
    claims = _claims(multiverse)
    lines = [
        "# The claims in every reading of the paper",
        "",
        _counts(multiverse),
        "",
        "Each claim of the paper is judged in each universe, a reading of the paper with one value "
        "for every choice that the paper leaves open. The tables below show in which share of the "
        "universes a claim is reproduced, and which choice decides.",
        "",
        *_verdict_tables(multiverse, claims),
        "## Choices",
        "",
        *_choice_table(multiverse),
        "",
        *_exclusions(multiverse),
        "## Universes",
        "",
        *_universe_table(multiverse),
        "",
        *_repeats(multiverse),
        "## Failures",
        "",
        *_failures(multiverse),
        "",
        "Written by `python -m study.run multiverse` with the settings and versions in "
        "`multiverse.json`. `effects.parquet` has every contrast of every claim in every universe, "
        "and `cells.parquet` and `repeats.parquet` the mean scores of every cell.",
    ]
    return "\n".join(lines) + "\n"


def _counts(multiverse: Multiverse) -> str:
    kinds = Counter(universe.kind for universe in multiverse.universes)
    found = multiverse.effects[multiverse.effects["effect"].notna()]
    seeds = set(found["seeds"])
    text = (
        f"{len(multiverse.scored)} of {len(multiverse.universes)} universes have scores: the "
        f"design has {kinds['base']} base readings, {kinds['one change']} with one change of a "
        f"base reading, and {kinds['random']} with random values."
    )
    return f"{text} {training_seeds(seeds)}; {basis(seeds)}." if seeds else text


def _verdict_tables(multiverse: Multiverse, claims: Sequence[Claim]) -> Iterator[str]:
    """A table of the paper's claims and one of the checks of this study."""
    if not claims:
        yield from ("No universe has scores for a claim.", "")
        return
    yield from ("![Share of universes with each verdict](figures/verdicts.png)", "")
    groups = {
        "## Claims of the paper": [claim for claim in claims if claim.section != OURS],
        "## Checks of this study": [claim for claim in claims if claim.section == OURS],
    }
    heads = ["claim", *(str(verdict) for verdict in VERDICTS), "effect", "strongest choice"]
    for title, group in groups.items():
        if group:
            yield from (title, "")
            yield f"| {' | '.join(heads)} |"
            yield f"|---|{'---:|' * (len(heads) - 2)}---|"
            yield from (_verdict_row(multiverse, claim) for claim in group)
            yield ""
    yield from (
        "- **effect**: of the decisive contrast, the one with the smallest effect: the median over "
        "the universes, and the range.",
        "- **strongest choice**: the choice without which a regression of the effect's rank on all "
        "choices explains least, and the share of the variance between universes that is lost: see "
        "[choices.md](choices.md).",
        "",
    )


def _verdict_row(multiverse: Multiverse, claim: Claim) -> str:
    found = shares(multiverse.effects, claim.id)
    effects = curve(multiverse.effects, claim.id)["effect"]
    figure = f"figures/specification_{claim.id}.png"
    entries = [
        f"[{claim.text}]({figure})",
        *(f"{share:.0%}" for share in found.values()),
        f"{effects.median():+.4f} ({effects.min():+.4f} to {effects.max():+.4f})",
        strongest_choice(multiverse, claim.id) or DASH,
    ]
    return f"| {' | '.join(entries)} |"


def _choice_table(multiverse: Multiverse) -> Iterator[str]:
    bases = list(multiverse.design.bases)
    yield f"| choice | question | values | {' | '.join(_name(base) for base in bases)} |"
    yield f"|---|---|---|{'---|' * len(bases)}"
    for choice in multiverse.design.choices:
        chosen = [markdown(multiverse.design.bases[base][choice.name]) for base in bases]
        values = "; ".join(_value(choice, value) for value in choice.values)
        entries = [_name(choice.name), markdown(choice.question), values, *chosen]
        yield f"| {' | '.join(entries)} |"


def _value(choice: Choice, value: str) -> str:
    settings = [f"`{key}={setting}`" for key, setting in choice.values[value].items()]
    return f"*{markdown(value)}*: {' '.join(settings) or 'as the settings of the multiverse'}"


def _exclusions(multiverse: Multiverse) -> Iterator[str]:
    if multiverse.design.exclusions:
        yield from ("Excluded combinations:", "")
        for rule in multiverse.design.exclusions:
            combination = ", ".join(f"{_name(name)}: {v}" for name, v in rule.values.items())
            yield f"- {markdown(combination)}. {markdown(rule.reason)}"
        yield ""


def _universe_table(multiverse: Multiverse) -> Iterator[str]:
    """What a universe changes, how well its models forecast, and how many claims are reproduced."""
    cells = multiverse.cells
    models = [name for name in dict.fromkeys(cells["model"]) if name != ORACLE]
    yield f"| universe | {' | '.join(f'{label(m)}: MMD²' for m in models)} | reproduced | values |"
    yield f"|---|{'---:|' * (len(models) + 1)}---|"
    means = cells.groupby(["universe", "model"])["mmd2"].mean()
    decisive = multiverse.effects[multiverse.effects["decisive"]]
    of_paper = {claim.id for claim in CLAIMS if claim.section != OURS}
    for universe in multiverse.universes:
        own = decisive[decisive["universe"] == universe.name]
        own = own[own["effect"].notna() & own["claim"].isin(of_paper)]
        mmd2 = [_number(means.get((universe.name, model))) for model in models]
        reproduced = f"{(own['verdict'] == 'reproduced').sum()} of {len(own)}" if len(own) else DASH
        entries = [f"`{universe.name}`", *mmd2, reproduced, _differences(multiverse, universe)]
        yield f"| {' | '.join(entries)} |"
    yield from (
        "",
        "MMD² is the mean over the environments, levels and seeds of the universe. The last column "
        f"has the values that differ from the reading *{_name(next(iter(multiverse.design.bases)))}"
        "*.",
    )


def _repeats(multiverse: Multiverse) -> Iterator[str]:
    """The scores of the base readings with each training seed."""
    if multiverse.repeats.empty:
        return
    yield from (
        "## Variation of training",
        "",
        "The base readings are trained with further seeds too. No verdict takes these fits into "
        "account. They show which differences between universes are due to chance. Each entry "
        "has the mean MMD² of one seed after the other, from seed "
        f"{multiverse.cells['seed'].min()} on.",
        "",
    )
    cells = pd.concat([multiverse.cells, multiverse.repeats], ignore_index=True)
    cells = cells[cells["universe"].isin(multiverse.repeats["universe"])]
    models = [name for name in dict.fromkeys(cells["model"]) if name != ORACLE]
    yield f"| universe | environment | level | {' | '.join(label(m) for m in models)} |"
    yield f"|---|---|---|{'---:|' * len(models)}"
    for place, part in cells.groupby(["universe", "environment", "level"], sort=False):
        found = [part[part["model"] == model].sort_values("seed")["mmd2"] for model in models]
        values = [", ".join(_number(float(value)) for value in row) or DASH for row in found]
        universe, environment, level = map(str, place)
        entries = [f"`{universe}`", label(environment), label(level), *values]
        yield f"| {' | '.join(entries)} |"
    yield ""


def _differences(multiverse: Multiverse, universe: Universe) -> str:
    reference = next(iter(multiverse.design.bases.values()))
    changes = [
        f"{_name(name)}: {value}"
        for name, value in universe.values.items()
        if value != reference[name]
    ]
    return markdown("; ".join(changes)) or DASH


def _failures(multiverse: Multiverse) -> Iterator[str]:
    if not multiverse.failures:
        yield "No stage failed."
        return
    yield "| universe | cell | failed stage | error |"
    yield "|---|---|---|---|"
    for failure in multiverse.failures:
        entries = [f"`{failure.universe}`", failure.cell, failure.stage, markdown(failure.error)]
        yield f"| {' | '.join(entries)} |"


def _choices_page(multiverse: Multiverse) -> str:
    lines = [
        "# Which choice moves the effect of each claim",
        "",
        "For each value of a choice: the mean change of the effect relative to the first "
        "value of the choice, by a linear regression over all universes without interactions, with "
        "a 95 % t interval (HC3). A change in bold has an interval without zero. *Rank*: the same "
        "for the rank of the effect among the universes, in percent of their number. A universe in "
        "which a model diverges has a large effect, but a rank like any other. *Share*: of the "
        "variance of the ranks, what is lost without the choice. The columns of the base readings "
        "show the change of the effect when that reading is changed in this choice alone. If they "
        "differ from each other, the choice interacts with others.",
        "",
        "The first table of a claim is about its decisive contrast, the one with the smallest "
        "effect in a universe. It may be another contrast in another universe, so a claim of two "
        "or three contrasts has a table for each of them too.",
        "",
    ]
    for claim in _claims(multiverse):
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
    rows = curve(multiverse.effects, claim.id, contrast)
    effects = rows.set_index("universe")["effect"]
    bases = list(multiverse.design.bases)
    yield (
        f"{regression.universes} universes. The choices explain {regression.explained:.0%} of the "
        "variance of the ranks."
    )
    yield ""
    heads = ["choice", "value", "universes", "change of the effect", "rank", "share"]
    yield f"| {' | '.join([*heads, *(f'at {_name(base)}' for base in bases)])} |"
    yield f"|---|---|---:|---:|---:|---:|{'---:|' * len(bases)}"
    order = sorted(regression.shares, key=regression.shares.__getitem__, reverse=True)
    for name in order:
        terms = [term for term in regression.terms if term.choice == name]
        for term in terms:
            at_bases = [_at_base(multiverse, effects, base, term) for base in bases]
            share = f"{regression.shares[name]:.0%}" if term is terms[0] else ""
            changes = [_change(term.effect, "{:+.4f}"), _change(term.rank, "{:+.0%}")]
            entries = [_name(name), markdown(term.value), str(term.universes), *changes, share]
            yield f"| {' | '.join([*entries, *at_bases])} |"


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


def _number(value: float | None) -> str:
    return DASH if value is None or not np.isfinite(value) else f"{value:.3f}"


def _sentence(text: str) -> str:
    """Text with a capital letter, without changing the other letters."""
    return text[:1].upper() + text[1:]


def _name(name: str) -> str:
    return name.replace("_", " ")
