"""The tables on posterior collapse in the page on models."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from paper_figs import posteriors
from paper_figs.formatting import NOTHING, number, title
from paper_figs.pages.marks import pipe_table
from study.common.files import read_json
from study.config.names import FULL, MLP

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
    """Every fit of a VAE in the results folder of a study."""
    found = posteriors.read_fits(study)
    if found.empty:
        return NO_FITS
    rows = posteriors.table(found, posteriors.latent_size(study))
    return pipe_table(list(posteriors.HEADS), rows)


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
