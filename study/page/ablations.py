"""The table of ablations: what each change of a setting does to the validation scores."""

import math
from collections.abc import Mapping
from typing import Any

from study.config.names import label
from study.page.evidence import ABLATIONS, Evidence
from study.page.tables import Table, figure, text

SCORES = {
    "mmd2": ("MMD²", 3),
    "brier_skill": ("Brier skill", 2),
    "variance_ratio": ("variance ratio", 2),
    "beta": ("β", 1),
}


def table(evidence: Evidence) -> Table | None:
    """One row for each change and cell; None without ablations."""
    by_change = (evidence.ablations or {}).get("scores")
    if not isinstance(by_change, Mapping):
        return None
    changes = evidence.settings.get("ablations", ())
    unchanged: Mapping[str, Any] = next(
        (cells for name, cells in by_change.items() if name not in changes), {}
    )
    rows = []
    for change, cells in by_change.items():
        for cell, scores in (cells if isinstance(cells, Mapping) else {}).items():
            if not isinstance(scores, Mapping):
                continue
            trace = f"{cell}\n{ABLATIONS}: {change}"
            ratio = _number(scores, "mmd2") / _number(unchanged.get(cell), "mmd2")
            rows.append(
                [
                    text(change),
                    text("/".join(map(label, str(cell).split("/")))),
                    *(
                        figure(_number(scores, name), f"{trace}: {name}", digits)
                        for name, (_, digits) in SCORES.items()
                    ),
                    figure(ratio, f"{trace}: MMD² / MMD² without the change", 2),
                ]
            )
    heads = ["change", "cell", *(name for name, _ in SCORES.values()), "MMD² / unchanged"]
    return Table("all-ablations", "Ablations", heads, rows, tools=True) if rows else None


def _number(scores: Any, name: str) -> float:
    """A score; NaN without it, or for zero as a denominator."""
    value = scores.get(name) if isinstance(scores, Mapping) else None
    return float(value) if isinstance(value, int | float) and value else math.nan
