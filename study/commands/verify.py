"""Command `verify`: check a results folder."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from study.commands.command import DEFAULT_OUT, Argument, Command, Flag
from study.commands.terminal import Bar, console, say
from study.common.errors import BadInput
from study.results import folder

if TYPE_CHECKING:
    from study.results.verify import Check

DETAILS = """\
checks   every file against SHA256SUMS; every recording against its checksum file; claims, tables
         and figures against those that are computed from the scores. Of a multiverse, the tables
         and figures against those that are computed from its effects
--rerun  evaluates a cell again from its weights. The test set is simulated again, unless work/ has
         it. On the same machine the scores are the same. Another machine may round differently: a
         score over all scenarios may differ by 0.001 (tables have three digits), and 1 % of all
         scores by more
exit     0 if nothing has changed since it was written, 1 if a file differs

examples
  python -m study.run verify results/paper
  python -m study.run verify results/paper --rerun uav/high/residual_vae/seed-0
  python -m study.run verify results/multiverse"""


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
    terminal, passed = console(), True
    with Bar(terminal) as bar:
        for check in _checks(options, bar):
            say(terminal, check.line)
            passed &= check.ok
    return 0 if passed else 1


def _checks(options: Options, bar: Bar) -> "Iterator[Check]":
    """Check the folder of a study or of a multiverse."""
    from study.results import verify, verify_multiverse

    if verify_multiverse.is_multiverse(options.out):
        if options.rerun is not None:
            raise BadInput(f"--rerun: {options.out} is a multiverse, and has no weights of cells")
        return verify_multiverse.verify(options.out, bar)
    results = folder.read(options.out)
    cell = None if options.rerun is None else results.cell(options.rerun, "--rerun")
    return verify.verify(results, cell, bar)


COMMAND = Command(
    "verify",
    "check the files of a study or multiverse, write its tables and figures again, and compare",
    Options,
    run,
    DETAILS,
)
