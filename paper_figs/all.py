"""All figures and tables of a study.

    python -m paper_figs.all results/paper

The list `SCRIPTS` is the only list of the scripts of this folder. Each of them has a function
`plot(results)` that reads the scores in a results folder and writes figures or tables into it.
"""

import sys
from pathlib import Path

from paper_figs import (
    base_rates,
    beta,
    calibration,
    fig1_trajectories,
    fig3_mmd,
    mmd_by_dimension,
    outcome_tables,
    reliability,
    score_tables,
    tables_1_2_brier,
    variance_ratio,
)
from paper_figs.command import command

SCRIPTS = (
    tables_1_2_brier,
    outcome_tables,
    score_tables,
    fig1_trajectories,
    fig3_mmd,
    mmd_by_dimension,
    reliability,
    calibration,
    variance_ratio,
    beta,
    base_rates,
)


def plot(results: Path) -> list[Path]:
    """Write all figures and tables of the folder `results`, from its scores alone.

    Returns:
        their paths.

    Raises:
        BadInput: there are no scores.
    """
    return [path for script in SCRIPTS for path in script.plot(results)]


if __name__ == "__main__":
    sys.exit(command(plot, "All figures and tables of a study."))
