"""Command `page`: the results of a study as one page for a browser."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from study.commands.command import DEFAULT_OUT, Argument, Command
from study.common.errors import BadInput
from study.common.files import why_not_writable

DETAILS = """\
Reads the files of a results folder and trains nothing. The page is one file, index.html: it loads
nothing from the network, and works without a server.

examples
  python -m study.run page
  python -m study.run page results/paper"""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of `page`.

    Attributes:
        out: the results folder.
    """

    out: Annotated[Path, Argument(f"results folder; {DEFAULT_OUT} by default")] = DEFAULT_OUT


def run(options: Options) -> int:
    """Write the page, and print its path."""
    from study.page.write import write_page

    if problem := why_not_writable(options.out):
        raise BadInput(f"cannot write to '{options.out}': {problem}")
    print(write_page(options.out))
    return 0


COMMAND = Command(
    "page",
    "the results as one page for a browser: verdicts, figures, tables",
    Options,
    run,
    DETAILS,
)
