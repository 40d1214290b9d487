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
    posteriors,
    reliability,
    score_tables,
    specification_curve,
    tables_1_2_brier,
    variance_ratio,
)
from paper_figs.command import command
from study.common.errors import StudyError
from study.common.plugins import reason

SCRIPTS = (
    tables_1_2_brier,
    outcome_tables,
    score_tables,
    posteriors,
    fig1_trajectories,
    fig3_mmd,
    mmd_by_dimension,
    reliability,
    calibration,
    variance_ratio,
    beta,
    base_rates,
    specification_curve,
)


def plot(results: Path) -> list[Path]:
    """Write all figures and tables of the folder `results`, from its scores alone.

    Returns:
        paths of the figures and tables.

    Raises:
        BadInput: there are no scores.
        StudyError: a script failed. The files of all other scripts are written.
    """
    paths, problems = [], []
    for script in SCRIPTS:
        try:
            paths += script.plot(results)
        except (StudyError, OSError):
            raise
        except Exception as error:
            problems.append(f"{script.__name__} could not draw ({reason(error)})")
    if problems:
        raise StudyError(f"{'; '.join(problems)}; all other tables and figures are written")
    return paths


if __name__ == "__main__":
    sys.exit(command(plot, "All figures and tables of a study."))
