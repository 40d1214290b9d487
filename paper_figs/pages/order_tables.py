"""The tables on the order of the models in the readings of the multiverse."""

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
import pandas as pd

from paper_figs import vae_scores
from paper_figs.formatting import NOTHING, number
from paper_figs.pages.marks import pipe_table
from study.claims.judge import Status
from study.config.names import FULL, MLP, MODELS, RESIDUAL, label
from study.multiverse.design import RANDOM, Universe
from study.multiverse.folder import Multiverse

MMD, BRIER = "MMD²", "Brier score"
CLAIMS = {MMD: "mmd-residual-lowest", BRIER: "brier-order"}
"""The claims on the order of the models, by the metric."""
COLUMNS = {MMD: "mmd2", BRIER: "brier"}
"""The column of ``cells.parquet``, by the metric."""
ENVIRONMENTS, LEVELS = ("pusher", "uav"), ("low", "high")
LIMITS = (0.05, 0.15)
"""Limits of the full VAE's MMD² between a low, a medium and a high one."""


def tables(found: Callable[[], Multiverse]) -> dict[str, Callable[[], str]]:
    """The functions that write the tables, by name.

    Args:
        found: reads the multiverse.
    """
    return {
        "orders": lambda: orders(found()),
        "paper-order": lambda: paper_order(found()),
        "lowest": lambda: lowest(found()),
        "by-full-vae": lambda: by_full_vae(found()),
        "turning": lambda: turning(found()),
    }


def contrast_with(other: str) -> str:
    """The contrast of the claims in `CLAIMS` between another model and the residual VAE."""
    return f"{label(other)} minus {label(RESIDUAL)}"


def orders(results: Multiverse) -> str:
    """In how many readings the residual VAE is better, and worse, than each of the other two.

    A column has the readings around one base reading, or those with random values. An entry such as
    `14 / 1` counts the contrasts that hold and those that are contradicted, see
    `study.claims.claim.Rule`.

    Args:
        results: of the multiverse.
    """
    count = _counts(results)
    effects = results.effects.assign(group=results.effects["universe"].map(_groups(results)))
    effects = effects[effects["effect"].notna()].set_index(["claim", "contrast", "group"])
    rows = []
    for metric, environment, level in product(CLAIMS, ENVIRONMENTS, LEVELS):
        claim = f"{CLAIMS[metric]}-{environment}-{level}"
        row = [f"{metric}, {label(environment)}, {label(level)}"]
        for other, group in product((FULL, MLP), count):
            at = (claim, contrast_with(other), group)
            row.append(_better_and_worse(effects["status"].get(at, pd.Series(dtype=str))))
        if set(row[1:]) != {NOTHING}:
            rows.append(row)
    names = [f"{label(group)} ({n})" for group, n in count.items()]
    others = (f"than the {label(other)}: {name}" for other in (FULL, MLP) for name in names)
    return pipe_table(["residual VAE better / worse", *others], rows)


def _better_and_worse(status: "pd.Series[str]") -> str:
    if status.empty:
        return NOTHING
    return f"{(status == Status.HOLDS).sum()} / {(status == Status.CONTRADICTED).sum()}"


def paper_order(results: Multiverse) -> str:
    """In how many readings the mean scores have the order of the paper.

    That is: the residual VAE is better than the full VAE, and this is better than the MLP.

    Args:
        results: of the multiverse.
    """

    def entry(means: pd.DataFrame) -> str:
        count = ((means[RESIDUAL] < means[FULL]) & (means[FULL] < means[MLP])).sum()
        return f"{count} of {len(means)}"

    return _by_group(results, "residual VAE < full VAE < MLP", (MMD, BRIER), entry)


def lowest(results: Multiverse) -> str:
    """In how many readings each model has the lowest mean score of the three.

    Args:
        results: of the multiverse.
    """

    def entry(means: pd.DataFrame) -> str:
        best = means.idxmin(axis=1)
        return " / ".join(str((best == model).sum()) for model in MODELS)

    head = f"lowest: {' / '.join(map(label, MODELS))}"
    return _by_group(results, head, (MMD, BRIER), entry)


def _by_group(
    results: Multiverse,
    head: str,
    metrics: tuple[str, ...],
    entry: Callable[[pd.DataFrame], str],
) -> str:
    """A table with a column for each group, made from the mean scores of the three models there."""
    count, group_of = _counts(results), _groups(results)
    rows = []
    for metric, environment, level in product(metrics, ENVIRONMENTS, LEVELS):
        cells = results.cells
        cells = cells[(cells["environment"] == environment) & (cells["level"] == level)]
        means = cells.groupby(["universe", "model"])[COLUMNS[metric]].mean().unstack("model")
        means = means.reindex(columns=list(MODELS)).replace(np.inf, np.nan).dropna()
        groups = means.index.map(group_of)
        parts = [means[groups == group] for group in count]
        if not means.empty:
            row = [f"{metric}, {label(environment)}, {label(level)}"]
            rows.append([*row, *(entry(part) if len(part) else NOTHING for part in parts)])
    return pipe_table([head, *(f"{label(group)} ({n})" for group, n in count.items())], rows)


def by_full_vae(results: Multiverse) -> str:
    """Which of the VAEs is better, by how good the full VAE is.

    A point is one reading at one level. The last column has the median of the full VAE's MMD²
    minus that of the residual VAE.

    Args:
        results: of the multiverse.
    """
    of_each = [
        part.assign(status=part["universe"].map(_statuses(results, *map(str, at))))
        for at, part in vae_scores.scores(results).groupby(["environment", "level"])
    ]
    points = pd.concat(of_each)
    low, high = LIMITS
    ranges = {f"below {low}": (0, low), f"{low} to {high}": LIMITS, f"from {high}": (high, np.inf)}
    rows = []
    for environment, (words, (first, end)) in product(ENVIRONMENTS, ranges.items()):
        inside = (points[FULL] >= first) & (points[FULL] < end)
        part = points[inside & (points["environment"] == environment)]
        if not part.empty:
            counts = [
                str((part["status"] == status).sum())
                for status in (Status.HOLDS, Status.UNDECIDED, Status.CONTRADICTED)
            ]
            median = number((part[FULL] - part[RESIDUAL]).median(), 3)
            rows.append([f"{label(environment)}, {words}", str(len(part)), *counts, median])
    heads = ["MMD² of the full VAE", "points", "residual VAE ahead", "undecided", "full VAE ahead"]
    return pipe_table([*heads, "median difference"], rows)


def turning(results: Multiverse) -> str:
    """The single changes of a base reading after which the other VAE is ahead by MMD².

    Args:
        results: of the multiverse.
    """
    ahead: dict[str, str] = {Status.HOLDS: label(RESIDUAL), Status.CONTRADICTED: label(FULL)}
    rows = []
    for base, environment, level in product(results.design.bases, ENVIRONMENTS, LEVELS):
        status = _statuses(results, environment, level)
        if base not in status:
            continue
        singles = [u for u in results.universes if u.base == base and u.changed]
        singles = [universe for universe in singles if universe.name in status]
        turned = []
        for other, words in ahead.items():
            changes = [u for u in singles if status[u.name] == other != status[base]]
            if changes:
                turned.append(
                    f"{words} ahead ({len(changes)} of {len(singles)}): {_listed(changes)}"
                )
        where = f"{label(base)}: {label(environment)}, {label(level)}"
        rows.append([where, ahead.get(status[base], "neither"), "; ".join(turned) or NOTHING])
    heads = ["base reading", "ahead in the base reading", "changes that reverse it"]
    return pipe_table(heads, rows, align="---")


def _listed(changes: Sequence[Universe]) -> str:
    """Single changes, such as `teacher forcing: scheduled or never, target: state`."""
    values: dict[str, list[str]] = {}
    for universe in changes:
        choice = str(universe.changed)
        values.setdefault(choice, []).append(universe.values[choice])
    return ", ".join(f"{label(name)}: {' or '.join(each)}" for name, each in values.items())


def _statuses(results: Multiverse, environment: str, level: str) -> dict[str, str]:
    """Whether the residual VAE has the lower MMD² than the full VAE, by universe."""
    effects = results.effects
    found = effects[
        (effects["claim"] == f"{CLAIMS[MMD]}-{environment}-{level}")
        & (effects["contrast"] == contrast_with(FULL))
    ]
    return dict(zip(found["universe"], found["status"], strict=True))


def _groups(results: Multiverse) -> dict[str, str]:
    """The group of each universe."""
    return {universe.name: universe.group for universe in results.universes}


def _counts(results: Multiverse) -> dict[str, int]:
    """How many readings of each group have scores."""
    groups = [universe.group for universe in results.universes if universe.name in results.scored]
    names = (*results.design.bases, RANDOM)
    return {group: groups.count(group) for group in names if group in groups}
