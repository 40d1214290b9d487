"""The pages of a multiverse: a summary of all claims, and what moves the effect of each."""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from study.claims.claim import OURS, Claim
from study.claims.judge import CLAIMS
from study.config.names import FULL, ORACLE, RESIDUAL, label, markdown
from study.metrics.intervals import basis, training_seeds
from study.multiverse.choices import DASH, choices_page, claims_of, strongest_choice
from study.multiverse.design import Choice, Universe
from study.multiverse.effects import VERDICTS, curve, shares
from study.multiverse.folder import REUSED, Multiverse
from study.multiverse.one_way import SIGNIFICANCE

KINDS = {
    "base": "base readings",
    "one change": "with one change of a base reading",
    "random": "with random values",
}
"""The kinds of universes in words."""


def pages(multiverse: Multiverse) -> dict[str, str]:
    """The text of each page, by the name of its file."""
    return {"README.md": _summary(multiverse), "choices.md": choices_page(multiverse)}


def counts_by_kind(multiverse: Multiverse) -> list[str]:
    """How many universes of each kind have scores, such as `2 of 2 base readings`."""
    names = set(multiverse.scored)
    planned = Counter(universe.kind for universe in multiverse.universes)
    scored = Counter(u.kind for u in multiverse.universes if u.name in names)
    return [f"{scored[kind]} of {planned[kind]} {words}" for kind, words in KINDS.items()]


def _summary(multiverse: Multiverse) -> str:
    claims = claims_of(multiverse)
    lines = [
        "# The claims in many readings of the paper",
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
    found = multiverse.effects[multiverse.effects["effect"].notna()]
    seeds = set(found["seeds"])
    counts = counts_by_kind(multiverse)
    text = (
        f"{len(multiverse.scored)} of {len(multiverse.universes)} universes have scores: "
        f"{', '.join(counts[:-1])} and {counts[-1]}."
    )
    if len(multiverse.scored) < len(multiverse.universes):
        text += " **The design is not complete: all shares are of these universes.**"
    if reused := multiverse.facts.get(REUSED):
        versions = sorted({f"{name} {v}" for other in reused.values() for name, v in other.items()})
        made = f", which was run with {', '.join(versions)}" if versions else ""
        text += f" The results of {len(reused)} universes were taken from another multiverse{made}."
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
        "choices explains least, and the share of the variance of the ranks that is lost, "
        "corrected for chance: see [choices.md](choices.md). There is a dash if no share is "
        f"significant (F test at the level {SIGNIFICANCE}, Bonferroni correction for the choices).",
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
    yield f"| choice | question | values | {' | '.join(label(base) for base in bases)} |"
    yield f"|---|---|---|{'---|' * len(bases)}"
    for choice in multiverse.design.choices:
        chosen = [markdown(multiverse.design.bases[base][choice.name]) for base in bases]
        values = "; ".join(_value(choice, value) for value in choice.values)
        entries = [label(choice.name), markdown(choice.question), values, *chosen]
        yield f"| {' | '.join(entries)} |"


def _value(choice: Choice, value: str) -> str:
    settings = [f"`{key}={setting}`" for key, setting in choice.values[value].items()]
    return f"*{markdown(value)}*: {' '.join(settings) or 'as the settings of the multiverse'}"


def _exclusions(multiverse: Multiverse) -> Iterator[str]:
    if multiverse.design.exclusions:
        yield from ("Excluded combinations:", "")
        for rule in multiverse.design.exclusions:
            combination = ", ".join(f"{label(name)}: {v}" for name, v in rule.values.items())
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
    reference = label(next(iter(multiverse.design.bases)))
    yield from (
        "",
        "MMD² is the mean over the environments, levels and seeds of the universe. The last column "
        f"has the values that differ from the reading *{reference}*.",
    )
    if {FULL, RESIDUAL} <= set(models):
        yield from (
            "",
            "![MMD² of the residual VAE against that of the full VAE](figures/vae_scores.png)",
        )


def _repeats(multiverse: Multiverse) -> Iterator[str]:
    """The scores of the base readings with each training seed."""
    if multiverse.repeats.empty:
        return
    yield from (
        "## Variation of training",
        "",
        "The MMD² of the base readings with further training seeds. No verdict takes these fits "
        "into account. A difference between universes of the size of the differences between "
        "seeds may be due to chance.",
        "",
    )
    cells = pd.concat([multiverse.cells, multiverse.repeats], ignore_index=True)
    cells = cells[cells["universe"].isin(multiverse.repeats["universe"])]
    models = [name for name in dict.fromkeys(cells["model"]) if name != ORACLE]
    yield f"| universe | environment | level | seed | {' | '.join(label(m) for m in models)} |"
    yield f"|---|---|---|---:|{'---:|' * len(models)}"
    for place, part in cells.groupby(["universe", "environment", "level"], sort=False):
        universe, environment, level = map(str, place)
        for seed, row in part.groupby("seed"):
            scores = row.set_index("model")["mmd2"]
            values = [_number(scores.get(model)) for model in models]
            entries = [f"`{universe}`", label(environment), label(level), str(seed), *values]
            yield f"| {' | '.join(entries)} |"
    yield ""


def _differences(multiverse: Multiverse, universe: Universe) -> str:
    reference = next(iter(multiverse.design.bases.values()))
    changes = [
        f"{label(name)}: {value}"
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


def _number(value: float | None) -> str:
    return DASH if value is None or not np.isfinite(value) else f"{value:.3f}"
