"""Command `join`: join studies with different seeds into one study."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from study.commands.command import Argument, Command, Flag

DETAILS = """\
The studies differ in their seeds alone. All files are checked first. Nothing is trained: tables,
figures, claims, the recording of the study and its page are written from the scores of all seeds.

examples
  python -m study.run all --config configs/paper.yaml --grid.seeds '[0]' --out results/one
  python -m study.run all --config configs/paper.yaml --grid.seeds '[1, 2]' --out results/two
  python -m study.run join results/one results/two --out results/both"""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of `join`.

    Attributes:
        folders: the results folders.
        out: the results folder to write.
    """

    folders: Annotated[list[str], Argument("results folders that differ in their seeds alone")]
    out: Annotated[Path, Flag("results folder to write; it must not exist")]


def run(options: Options) -> int:
    """Join the studies, and print the new results folder."""
    from study.page.write import write_page
    from study.results.join import join

    folders = [Path(folder) for folder in options.folders]
    join(folders, options.out)
    write_page(options.out)
    print(options.out)
    return 0


COMMAND = Command(
    "join",
    "join studies with different seeds into one study: join DIR DIR",
    Options,
    run,
    DETAILS,
)
