"""The tables of the multiverse: every claim in every reading, and the effect of each choice."""

from collections.abc import Callable, Mapping
from functools import cache
from itertools import product
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from paper_figs.formatting import NOTHING, number
from paper_figs.pages import order_tables
from paper_figs.pages.claim_tables import Claims, of_the_paper
from paper_figs.pages.marks import pipe_table
from paper_figs.pages.order_tables import CLAIMS, ENVIRONMENTS, LEVELS, contrast_with
from study.common.files import read_json
from study.config.names import FULL, MLP, MODELS, label
from study.multiverse import folder
from study.multiverse.choices import each_alone, influence_on, strongest_choice
from study.multiverse.design import RANDOM
from study.multiverse.effects import VERDICTS, curve, judged, shares
from study.multiverse.folder import Multiverse
from study.multiverse.influence import Influence
from study.multiverse.one_way import OneWay
from study.multiverse.report import counts_by_kind

NOT_RUN = "The multiverse has not been run: `python -m study.run multiverse`."


def tables(results: Path) -> dict[str, Callable[[], str]]:
    """The functions that write the tables, by name.

    Args:
        results: the folder with the committed results, ``results/`` of the repository. If it has
            no multiverse, each table is a sentence.
    """
    path = results / "multiverse"
    found = cache(lambda: folder.read(path))
    written = {
        "readings": lambda: readings(read_json(results / "paper" / "claims.json"), found()),
        **order_tables.tables(found),
        "deciding": lambda: deciding(found()),
        "spread": lambda: spread(found()),
        "base-readings": lambda: base_readings(found()),
        "changes": lambda: changes(found(), "study"),
        "changes-as-written": lambda: changes(found(), "as_written"),
    }
    exists = (path / folder.FACTS).is_file()
    return written if exists else dict.fromkeys(written, lambda: NOT_RUN)


def readings(claims: Claims, results: Multiverse) -> str:
    """Every claim of the paper in the universes of the multiverse.

    The columns: the share of universes with each verdict, the verdict in each base reading, and the
    choice that moves the effect most. The claim links to its specification curve.

    Args:
        claims: of the study.
        results: of the multiverse.
    """
    bases = list(results.design.bases)
    heads = ["claim", *(v.value for v in VERDICTS), *map(label, bases), "strongest choice"]
    names = judged(results.effects)
    rows = [
        _reading(results, claim, bases) for claim in of_the_paper(claims) if claim["id"] in names
    ]
    count = f"{len(results.scored)} of {len(results.universes)} readings have been run."
    if len(results.scored) < len(results.universes):
        counts = ", ".join(counts_by_kind(results))
        count = f"{count[:-1]} so far: {counts}. All shares are of these readings."
    return f"{count}\n\n{pipe_table(heads, rows, align='---')}"


def deciding(results: Multiverse) -> str:
    """What a regression on the choices explains of the advantage of the residual VAE.

    The columns: the share of the variance of ranks that all choices explain, the choice that
    explains most without the others, the choices that add a significant share to the others, and
    the choice that explains most over the readings with random values. See
    `study.multiverse.influence.Influence` and `study.multiverse.one_way.OneWay`.

    Args:
        results: of the multiverse.
    """
    rows = []
    for other, metric, environment, level in product((FULL, MLP), CLAIMS, ENVIRONMENTS, LEVELS):
        claim = f"{CLAIMS[metric]}-{environment}-{level}"
        of = (results, claim, contrast_with(other))
        found = influence_on(*of)
        if found is not None:
            where = f"over the {label(other)}: {metric}, {label(environment)}, {label(level)}"
            alone, random = _best(each_alone(*of)), _best(each_alone(*of, RANDOM), marked=True)
            rows.append([where, f"{found.explained:.0%}", alone, _added(found), random])
    if not rows:
        return "Too few readings have been run to tell the choices apart."
    heads = ["advantage of the residual VAE", "all choices", "largest share: one choice"]
    heads += ["significant shares, given the others", "largest share: one choice, random values"]
    return pipe_table(heads, rows, align="---")


def _best(alone: Mapping[str, OneWay], *, marked: bool = False) -> str:
    """The choice with the largest share; if it is to be marked, in bold where significant."""
    choice = max(alone, key=lambda name: alone[name].share, default=None)
    if choice is None or not alone[choice].share:
        return NOTHING
    best = alone[choice]
    text = f"{label(choice)} {best.share:.0%}"
    return f"**{text}**" if marked and best.is_significant else text


def _added(found: Influence) -> str:
    """The choices that add a significant share to the others."""
    added = [
        f"{label(choice)} {share:.0%}"
        for choice, share in sorted(found.shares.items(), key=itemgetter(1), reverse=True)
        if found.is_significant(choice)
    ]
    return ", ".join(added) or NOTHING


def spread(results: Multiverse) -> str:
    """How much the reading changes MMD²: its median and quartiles over all universes.

    Args:
        results: of the multiverse.
    """
    cells = results.cells[results.cells["model"].isin(MODELS)]
    means = cells.groupby(["environment", "level", "model", "universe"])["mmd2"].mean()
    rows = []
    for environment, level in product(ENVIRONMENTS, LEVELS):
        row = [f"{label(environment)}, {label(level)}"]
        for model in MODELS:
            of_model = means.get((environment, level, model), pd.Series(dtype=float))
            first, median, third = of_model.quantile([0.25, 0.5, 0.75])
            row.append(f"{median:.3f} ({first:.3f} to {third:.3f})" if len(of_model) else NOTHING)
        if set(row[1:]) != {NOTHING}:
            rows.append(row)
    return pipe_table(["MMD²: median (quartiles)", *map(label, MODELS)], rows)


def base_readings(results: Multiverse) -> str:
    """MMD² of each model in each base reading.

    Args:
        results: of the multiverse.
    """
    bases = [base for base in results.design.bases if base in results.scored]
    means = results.cells.groupby(["environment", "level", "model", "universe"])["mmd2"].mean()
    rows = []
    for environment, level in product(ENVIRONMENTS, LEVELS):
        entries = [
            number(means.get((environment, level, model, base)))
            for model, base in product(MODELS, bases)
        ]
        if set(entries) != {NOTHING}:
            rows.append([f"{label(environment)}, {label(level)}", *entries])
    heads = [f"{label(model)}: {label(base)}" for model, base in product(MODELS, bases)]
    return pipe_table(["MMD²", *heads], rows)


def changes(results: Multiverse, base: str, level: str = "low") -> str:
    """MMD² of each model with one change of a base reading / MMD² without the change.

    A dash stands where the change does not concern the model, and *failed* where there is no score.

    Args:
        results: of the multiverse.
        base: the base reading.
        level: the epistemic level.
    """
    cells = results.cells[results.cells["level"] == level]
    means = cells.groupby(["universe", "model", "environment"])["mmd2"].mean()
    columns = [(model, environment) for model in MODELS for environment in ENVIRONMENTS]
    rows = []
    for universe in results.universes:
        if universe.base == base and universe.changed and universe.name in results.scored:
            change = f"{label(universe.changed)}: {universe.values[universe.changed]}"
            ratios = [_ratio(means, (universe.name, *at), (base, *at)) for at in columns]
            rows.append([change, *ratios])
    heads = ["change", *(f"{label(model)}, {label(where)}" for model, where in columns)]
    return pipe_table(heads, rows)


def _ratio(means: "pd.Series[float]", new: tuple[str, ...], old: tuple[str, ...]) -> str:
    ratio = means.get(new, np.nan) / means.get(old, np.nan)
    if not np.isfinite(ratio):
        return "failed"
    return NOTHING if ratio == 1 else f"{ratio:.2f}"


def _reading(results: Multiverse, claim: dict[str, Any], bases: list[str]) -> list[str]:
    verdict = curve(results.effects, claim["id"]).set_index("universe")["verdict"]
    return [
        f"[{claim['text']}](../multiverse/figures/specification_{claim['id']}.png)",
        *(f"{share:.0%}" for share in shares(results.effects, claim["id"]).values()),
        *(str(verdict.get(base, NOTHING)) for base in bases),
        strongest_choice(results, claim["id"]) or NOTHING,
    ]
