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
Of two folders it compares the settings, scores, verdicts and versions, and writes the page into the
second one: "did my change help?"

examples
  python -m study.run page
  python -m study.run page results/paper
  python -m study.run page results/paper results/mine"""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of `page`.

    Attributes:
        out: the results folder.
        other: a second results folder, to compare with `out`; None for the page of `out`.
    """

    out: Annotated[Path, Argument(f"results folder; {DEFAULT_OUT} by default")] = DEFAULT_OUT
    other: Annotated[Path | None, Argument("a second results folder, to compare")] = None


def run(options: Options) -> int:
    """Write the page, and print its path."""
    from study.page.comparison import write_comparison
    from study.page.evidence import check_folder
    from study.page.write import write_page

    target = options.other or options.out
    check_folder(target)
    if options.other is not None and options.other.resolve() == options.out.resolve():
        raise BadInput(f"'{options.out}' and '{options.other}' are one folder; give two folders")
    if problem := why_not_writable(target):
        raise BadInput(f"cannot write to '{target}': {problem}")
    print(write_comparison(options.out, target) if options.other else write_page(target))
    return 0


COMMAND = Command(
    "page",
    "the results as one page for a browser: verdicts, figures, tables",
    Options,
    run,
    DETAILS,
)
