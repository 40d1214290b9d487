"""Table of the posteriors of the fitted VAEs: whether each of them uses its latent variable.

    python -m paper_figs.posteriors results/paper

One row for each fit. The numbers are those of the stage train on validation trajectories, see
`study.models.posterior`.
"""

import json
import sys
from pathlib import Path
from typing import Any

import pandas as pd

from paper_figs.command import command
from paper_figs.formatting import NOTHING, beyond, latex, number, title
from paper_figs.scores import environments, levels, models
from study.common.errors import BadInput
from study.config.names import label

COLLAPSED_BELOW = 0.1
"""KL divergence, in nats a step, below which a posterior counts as collapsed."""

HEADS = (
    "environment",
    "level",
    "model",
    "seed",
    "β",
    "KL (nats a step)",
    "active units",
    "share of variance from z",
    "posterior",
)
NAMES = 3
"""Columns with text, aligned to the left; the columns after them have numbers."""

MISSING = "nothing to write: no fits.parquet with a VAE; the study has none, or was made before"


def plot(results: Path) -> list[Path]:
    """Write tables/posteriors.md and .tex into `results`; nothing without fitted VAEs.

    A study that was made before the study had ``fits.parquet`` has no such numbers.

    Raises:
        BadInput: there is no such folder.
    """
    if not results.is_dir():
        raise BadInput(f"there is no folder {results}: run `python -m study.run all` first")
    fits = read_fits(results)
    if fits.empty:
        return []
    rows, notes = table(fits, latent_size(results)), notes_of(fits)
    folder = results / "tables"
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for suffix, write in (("md", to_markdown), ("tex", to_latex)):
        path = folder / f"posteriors.{suffix}"
        path.write_text(write(rows, notes), encoding="utf-8")
        written.append(path)
    return written


def read_fits(results: Path) -> pd.DataFrame:
    """The fits of VAEs in ``fits.parquet``, in the order of the tables; none without the file."""
    path = results / "fits.parquet"
    if not path.is_file():
        return pd.DataFrame()
    fits = pd.read_parquet(path)
    fits = fits[fits["kl"].notna()]
    order = {
        "environment": environments(fits),
        "level": levels(fits),
        "model": models(fits),
    }
    ranks = pd.DataFrame({name: fits[name].map(names.index) for name, names in order.items()})
    ranks["seed"] = fits["seed"]
    return fits.loc[ranks.sort_values(list(ranks.columns)).index]


def latent_size(results: Path) -> int | None:
    """The setting ``vae.latent_size`` Z, from ``study.json``; None without it."""
    try:
        settings = json.loads((results / "study.json").read_text(encoding="utf-8"))["settings"]
        return int(settings["vae"]["latent_size"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def table(fits: pd.DataFrame, size: int | None) -> list[list[str]]:
    """The texts of each row.

    Args:
        fits: see `read_fits`.
        size: Z.
    """
    return [_row(fit, size) for fit in fits.to_dict("records")]


def posterior(kl: float) -> str:
    """What a KL divergence in nats a step means: ``used`` or ``collapsed``."""
    return "collapsed" if kl < COLLAPSED_BELOW else "used"


def beta(value: float | None) -> str:
    """β with two significant digits; a dash for None and NaN."""
    if value is None or pd.isna(value):
        return NOTHING
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def to_markdown(rows: list[list[str]], notes: list[str]) -> str:
    """A heading, a pipe table and notes."""
    rule = "|---" * NAMES + "|---:" * (len(HEADS) - NAMES - 1) + "|---|"
    lines = [f"| {' | '.join(texts)} |" for texts in rows]
    heads = f"| {' | '.join(HEADS)} |"
    return "\n".join(["# Posteriors of the VAEs", "", heads, rule, *lines, "", *notes, ""])


def to_latex(rows: list[list[str]], notes: list[str]) -> str:
    """A table with booktabs."""
    columns = "l" * NAMES + "r" * (len(HEADS) - NAMES - 1) + "l"
    return "\n".join(
        [
            "% needs \\usepackage{booktabs}",
            "\\begin{table*}",
            f"\\caption{{Posteriors of the VAEs. {_latex(' '.join(notes))}}}",
            "\\label{posteriors}",
            "\\centering",
            f"\\begin{{tabular}}{{{columns}}}",
            "\\toprule",
            " & ".join(map(_latex, HEADS)) + " \\\\",
            "\\midrule",
            *(" & ".join(map(_latex, texts)) + " \\\\" for texts in rows),
            "\\bottomrule",
            "\\end{tabular}",
            "\\end{table*}",
            "",
        ]
    )


def notes_of(fits: pd.DataFrame) -> list[str]:
    """What the columns mean."""
    return [
        "On validation trajectories, after the fit. KL: of the posterior q(z | ·) from the prior "
        f"N(0, I); below {COLLAPSED_BELOW:g} nats a step the posterior counts as collapsed. "
        "Active units: components whose posterior mean varies by more than 0.01 (variance). Share "
        "of variance from z: that part of the one-step variance given the history; the rest is "
        "the normal noise of p(s | ·). Where a forecast is the decoder's mean, it has no such "
        "noise, and all of its variance is from z.",
        *beyond(fits["model"]),
    ]


def _row(fit: dict[Any, Any], size: int | None) -> list[str]:
    units = number(fit["active_units"], 0 if float(fit["active_units"]).is_integer() else 1)
    return [
        title(fit["environment"]),
        label(fit["level"]),
        title(fit["model"]),
        str(fit["seed"]),
        beta(fit["beta"]),
        number(fit["kl"]),
        units if size is None else f"{units} of {size}",
        number(fit["latent_share"], 2),
        posterior(fit["kl"]),
    ]


def _latex(text: str) -> str:
    return latex(text).replace("β", "$\\beta$").replace("·", "$\\cdot$")


if __name__ == "__main__":
    about = "Table of the posteriors of the fitted VAEs."
    sys.exit(command(plot, about, missing=MISSING))
