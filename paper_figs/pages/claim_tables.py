"""The tables of the verdicts at the paper's size."""

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from paper_figs.formatting import NOTHING, signed
from paper_figs.pages.marks import pipe_table
from study.claims.claim import OURS
from study.common.files import read_json
from study.multiverse.effects import VERDICTS

SECTIONS = {
    "Pusher (section IV-A)": "IV-A",
    "UAV (section IV-B)": "IV-B",
    "checks of our own": OURS,
}

Claims = list[dict[str, Any]]
"""``claims.json`` of a study."""


def tables(results: Path) -> dict[str, Callable[[], str]]:
    """The functions that write the tables, by name.

    Args:
        results: the folder with the committed results, ``results/`` of the repository.
    """

    def claims_of_the_study() -> Claims:
        claims: Claims = read_json(results / "paper" / "claims.json")
        return claims

    return {
        "verdicts": lambda: verdicts(claims_of_the_study()),
        "claims": lambda: claims(claims_of_the_study()),
    }


def verdicts(claims: Claims) -> str:
    """The number of claims of each section with each verdict."""
    groups = {"**the paper's claims**": of_the_paper(claims)} | {
        name: [claim for claim in claims if claim["section"] == section]
        for name, section in SECTIONS.items()
    }
    rows = []
    for name, group in groups.items():
        counts = Counter(claim["verdict"] for claim in group)
        rows.append([name, str(len(group)), *(str(counts[verdict.value]) for verdict in VERDICTS)])
    return pipe_table(["", "claims", *(verdict.value for verdict in VERDICTS)], rows)


def claims(claims: Claims) -> str:
    """Every claim of the paper, its verdict, and the effect that decides it."""
    rows = []
    for claim in of_the_paper(claims):
        finding = claim["smallest_finding"]
        effect = (
            signed(float(finding["effect"]), float(finding["low"]), float(finding["high"]))
            if finding
            else NOTHING
        )
        rows.append([claim["text"], claim["verdict"], effect])
    return pipe_table(["claim", "verdict", "effect [95 % interval]"], rows, align="---")


def of_the_paper(claims: Claims) -> Claims:
    """The claims without the checks of this study."""
    return [claim for claim in claims if claim["section"] != OURS]
