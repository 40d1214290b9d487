"""The tables on posterior collapse in the page on models."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd

from paper_figs import posteriors
from paper_figs.formatting import NOTHING, number, title
from paper_figs.pages.marks import pipe_table
from study.common.files import read_json
from study.config.names import FULL, MLP, label

NO_FITS = "`results/paper` was made before the study had these statistics, so it has no such table."


def tables(results: Path) -> dict[str, Callable[[], str]]:
    """The functions that write the tables, by name.

    Args:
        results: the folder with the committed results, ``results/`` of the repository.
    """
    return {
        "posteriors": lambda: fits(results / "paper"),
        "fork": lambda: fork(read_json(results / "fork" / "ablations.json")),
    }


def fits(study: Path) -> str:
    """The VAEs in the results folder of a study: the range of each number over the seeds."""
    found = posteriors.read_fits(study)
    if found.empty:
        return NO_FITS
    heads = ["", "β", "KL (nats a step)", "active units", "share of variance from z", "collapsed"]
    rows = []
    for names, group in found.groupby(["environment", "level", "model"], sort=False):
        collapsed = sum(posteriors.posterior(kl) == "collapsed" for kl in group["kl"])
        texts = [
            _ends(group["beta"], posteriors.beta),
            _ends(group["kl"], number),
            _ends(group["active_units"], lambda count: f"{count:g}"),
            _ends(group["latent_share"], lambda share: number(share, 2)),
            f"{collapsed} of {len(group)}",
        ]
        rows.append([title(", ".join(label(str(name)) for name in names)), *texts])
    return pipe_table(heads, rows)


def _ends(values: "pd.Series[float]", text: Callable[[float], str]) -> str:
    """The smallest and the largest value, or one text if both have the same."""
    return " to ".join(dict.fromkeys((text(values.min()), text(values.max()))))


def fork(record: dict[str, Any]) -> str:
    """The full VAE with each range of β, and the probabilistic MLP, on the system `fork`.

    Args:
        record: what the command `ablate` wrote for ``configs/fork.yaml``.
    """
    (changed,) = record["settings"]["ablations"]
    (unchanged,) = record["scores"].keys() - {changed}
    rows = [
        _row(FULL, record["scores"][unchanged]),
        _row(FULL, record["scores"][changed]),
        _row(MLP, record["scores"][unchanged]),
    ]
    heads = ["model", "β", "KL (nats a step)", "share of variance from z", "posterior", "MMD²"]
    return pipe_table(heads, rows)


def _row(model: str, scores: dict[str, dict[str, float | None]]) -> list[str]:
    (fit,) = [values for cell, values in scores.items() if f"/{model}/" in cell]
    kl = fit.get("kl")
    return [
        title(model),
        posteriors.beta(fit["beta"]),
        number(kl),
        number(fit.get("latent_share"), 2),
        NOTHING if kl is None else posteriors.posterior(kl),
        number(fit["mmd2"], 4),
    ]
