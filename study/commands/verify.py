"""Command `verify`: check a results folder."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from study.commands.command import DEFAULT_OUT, Argument, Command, Flag
from study.commands.terminal import Bar, console, say
from study.results import folder

DETAILS = """\
checks   every file against SHA256SUMS; every recording against its checksum file; claims, tables
         and figures against those that are computed from the scores
--rerun  evaluates a cell again from its weights. The test set is simulated again, unless work/ has
         it. On the same machine the scores are the same. Another machine may round differently: a
         score over all scenarios may differ by 0.001 (tables have three digits), and 1 % of all
         scores by more
exit     0 if nothing has changed since it was written, 1 if a file differs

examples
  python -m study.run verify results/paper
  python -m study.run verify results/paper --rerun uav/high/residual_vae/seed-0"""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of `verify`.

    Attributes:
        out: the results folder.
        rerun: name of a cell to evaluate again; None for no cell.
    """

    out: Annotated[Path, Argument(f"results folder; {DEFAULT_OUT} by default")] = DEFAULT_OUT
    rerun: Annotated[str | None, Flag("evaluate this cell again, and compare its scores")] = None


def run(options: Options) -> int:
    """Print one line for each check."""
    results = folder.read(options.out)
    cell = None if options.rerun is None else results.cell(options.rerun, "--rerun")
    from study.results.verify import verify

    terminal, passed = console(), True
    with Bar(terminal) as bar:
        for check in verify(results, cell, bar):
            say(terminal, check.line)
            passed &= check.ok
    return 0 if passed else 1


COMMAND = Command(
    "verify",
    "check the files of a study, write its tables and figures again, and compare",
    Options,
    run,
    DETAILS,
)
