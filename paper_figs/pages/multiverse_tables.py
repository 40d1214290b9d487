"""The tables of the multiverse: every claim in every reading, and the effect of each choice."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from paper_figs.formatting import NOTHING
from paper_figs.pages.claim_tables import Claims, of_the_paper
from paper_figs.pages.marks import pipe_table
from study.common.files import read_json
from study.config.names import MODELS, label
from study.multiverse import folder
from study.multiverse.choices import strongest_choice
from study.multiverse.effects import VERDICTS, curve, judged, shares
from study.multiverse.folder import Multiverse
from study.multiverse.report import KINDS, kinds_of

NOT_RUN = "The multiverse has not been run: `python -m study.run multiverse`."
ENVIRONMENTS = ("pusher", "uav")


def tables(results: Path) -> dict[str, Callable[[], str]]:
    """The functions that write the tables, by name.

    Args:
        results: the folder with the committed results, ``results/`` of the repository.
    """
    path = results / "multiverse"
    return {
        "readings": lambda: readings(read_json(results / "paper" / "claims.json"), path),
        "changes": lambda: changes(path),
    }


def readings(claims: Claims, path: Path) -> str:
    """Every claim of the paper in the universes of the multiverse.

    The columns: the share of universes with each verdict, the verdict in each base reading, and the
    choice that moves the effect most. The claim links to its specification curve.

    Args:
        claims: of the study.
        path: the results folder of the multiverse. Without one, the table is a sentence.
    """
    if not (path / folder.FACTS).is_file():
        return NOT_RUN
    results = folder.read(path)
    bases = list(results.design.bases)
    heads = ["claim", *(v.value for v in VERDICTS), *map(label, bases), "strongest choice"]
    names = judged(results.effects)
    rows = [
        _reading(results, claim, bases) for claim in of_the_paper(claims) if claim["id"] in names
    ]
    count = f"{len(results.scored)} of {len(results.universes)} readings have been run."
    if len(results.scored) < len(results.universes):
        planned, scored = kinds_of(results)
        counts = [f"{scored[kind]} of {planned[kind]} {name}" for kind, name in KINDS.items()]
        count = f"{count[:-1]} so far: {', '.join(counts)}. All shares are of these readings."
    return f"{count}\n\n{pipe_table(heads, rows, align='---')}"


def changes(path: Path, base: str = "study", level: str = "low") -> str:
    """MMD² of each model with one change of a base reading / MMD² without the change.

    A dash stands where the change does not concern the model, and *failed* where there is no score.

    Args:
        path: the results folder of the multiverse. Without one, the table is a sentence.
        base: the base reading.
        level: the epistemic level.
    """
    if not (path / folder.FACTS).is_file():
        return NOT_RUN
    results = folder.read(path)
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
