"""Command `join`: join studies with different seeds, or multiverses with different universes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from study.commands.command import Argument, Command, Flag
from study.common.errors import BadInput

DETAILS = """\
The studies differ in their seeds alone. All files are checked first. Nothing is trained: tables,
figures, claims, the recording of the study and its page are written from the scores of all seeds.
Multiverses have the same design. They have different universes, or the same results of a universe.

examples
  python -m study.run all --config configs/paper.yaml --grid.seeds '[0]' --out results/one
  python -m study.run all --config configs/paper.yaml --grid.seeds '[1, 2]' --out results/two
  python -m study.run join results/one results/two --out results/both
  python -m study.run multiverse --universes 'study*' --out results/part-1
  python -m study.run multiverse --universes 'random-*' --out results/part-2
  python -m study.run join results/part-1 results/part-2 --out results/readings"""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of `join`.

    Attributes:
        folders: the results folders.
        out: the results folder to write.
    """

    folders: Annotated[list[str], Argument("folders with different seeds or universes")]
    out: Annotated[Path, Flag("results folder to write; it must not exist")]


def run(options: Options) -> int:
    """Join the studies or multiverses, and print the new results folder."""
    from study.page.write import write_page
    from study.results import join, join_multiverse
    from study.results.folder import read
    from study.results.verify_multiverse import is_multiverse

    folders = [Path(folder) for folder in options.folders]
    multiverses = [folder for folder in folders if is_multiverse(folder)]
    studies = [folder for folder in folders if folder not in multiverses]
    if multiverses and studies:
        read(studies[0])
        raise BadInput(f"join: {multiverses[0]} is a multiverse, and {studies[0]} is a study")
    if multiverses:
        join_multiverse.join(folders, options.out)
    else:
        join.join(folders, options.out)
        write_page(options.out)
    print(options.out)
    return 0


COMMAND = Command(
    "join",
    "join studies with different seeds, or multiverses with different universes: join DIR DIR",
    Options,
    run,
    DETAILS,
)
