"""Command `figures`: write tables and figures again from the scores alone."""

from dataclasses import dataclass

from study.commands.command import Command, StudyOptions

DETAILS = """\
Reads scores.parquet, trials.parquet and illustrations/ of OUT, and trains nothing.

examples
  python -m study.run figures
  python -m study.run figures --out results/paper"""


@dataclass(frozen=True, kw_only=True)
class Options(StudyOptions):
    """Options of `figures`: the settings alone, for the name of the results folder."""


def run(options: Options) -> int:
    """Write tables and figures, and print their paths."""
    from study.results.summary import plot

    for path in plot(options.out):
        print(path)
    return 0


COMMAND = Command(
    "figures", "write tables and figures again from the scores alone", Options, run, DETAILS
)
