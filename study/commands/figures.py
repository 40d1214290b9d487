"""Command `figures`: write claims, tables, figures and the page again, without training."""

from dataclasses import dataclass

from study.commands.command import Command, StudyOptions
from study.common.errors import BadInput
from study.results import checksums
from study.results.folder import check_writable
from study.workflow.lock import locked

DETAILS = """\
Reads scores.parquet, trials.parquet, fits.parquet, study.json and illustrations/ of OUT, and trains
nothing.
Writes the verdicts on the claims, tables/, figures/, their checksums in SHA256SUMS, and index.html.

examples
  python -m study.run figures
  python -m study.run figures --out results/paper"""


@dataclass(frozen=True, kw_only=True)
class Options(StudyOptions):
    """Options of `figures`: the settings alone, for the name of the results folder."""


def run(options: Options) -> int:
    """Write claims, tables, figures and the page, and print their paths.

    Raises:
        BadInput: there are no scores, or the folder is in use or not writable.
        StudyError: the scores are damaged.
    """
    import pandas as pd

    from study.page.write import write_page
    from study.results import summary

    out = options.out
    if not (out / summary.SCORES).is_file():
        raise BadInput(
            f"--out: {out} has no {summary.SCORES}; run the study: python -m study.run all"
        )
    check_writable(out)
    with locked(out):
        has_checksums = (out / checksums.NAME).is_file()
        if has_checksums:
            # A study that was made before the study had the table of fits has none.
            fits = [summary.FITS] if (out / summary.FITS).is_file() else []
            for name in (summary.SCORES, summary.TRIALS, *fits):
                checksums.check(out / name, out)
        try:
            summary.write_claims(pd.read_parquet(out / summary.SCORES), out)
            paths = [out / summary.CLAIMS, out / summary.VERDICTS, *summary.plot(out)]
        finally:  # if a figure fails, the other figures are written
            if has_checksums:
                checksums.renew(out, (*summary.PLOTTED, summary.CLAIMS, summary.VERDICTS))
            page = write_page(out)
        paths.append(page)
    for path in paths:
        print(path)
    return 0


COMMAND = Command(
    "figures",
    "write claims, tables, figures and the page again, without training",
    Options,
    run,
    DETAILS,
)
